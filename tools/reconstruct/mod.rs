//! `reconstruct`: evaluates a model on any sampling of the sphere.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use spharm_cli::Common;
use spharm_cli::inputs::read_sphere;
use spharm_cli::output::{print, refuse_existing};
use spharm_cli::threads::Threads;
use spharm_harmonics::Directions;
use spharm_surface::generate::icosphere;
use spharm_surface::io::{WriteOptions, write_mesh, write_signal};
use spharm_surface::{Mesh, Model, Signal};
use spharm_transform::synthesis;

/// Evaluate a fitted model, to any degree, at the vertices of any sphere
///
/// With a lower --degree a coarser version of the surface comes out, with --icosphere or --sphere the surface on
/// another mesh. A model of a signal gives a signal.
#[derive(Debug, clap::Args)]
pub(crate) struct Cli {
    /// Model, as fit writes it
    #[arg(long, value_name = "MODEL.spharm.npz")]
    model: PathBuf,
    /// Highest degree to use [default: the model's]
    #[arg(long, value_name = "D")]
    degree: Option<usize>,
    #[command(flatten)]
    sampling: Sampling,
    /// Surface to write, in the format of its name (.ply, .surf.gii, .obj, ...); for signals .func.gii, .csv, ...
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Write 64-bit positions where the format has a choice
    #[arg(long)]
    double: bool,
    /// Replace an output that exists
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    threads: Threads,
    #[command(flatten)]
    common: Common,
}

#[derive(Debug, clap::Args)]
#[group(multiple = false)]
struct Sampling {
    /// On the vertices and triangles of a sphere mesh
    #[arg(long, value_name = "MESH")]
    sphere: Option<PathBuf>,
    /// On an icosphere of N subdivisions: 10 4^N + 2 vertices
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=12))]
    icosphere: Option<u32>,
    /// On the sampling that the model was fitted on (the default)
    #[arg(long)]
    original: bool,
}

/// Runs the verb.
pub(crate) fn run(cli: &Cli) -> Result<()> {
    let started = Instant::now();
    let console = cli.common.console();
    refuse_existing(&cli.output, cli.force, "output", "--output")?;
    let model = Model::read(&cli.model)?;
    let degree = cli.degree.unwrap_or(model.coefficients.max_degree());
    if degree > model.coefficients.max_degree() {
        let has = model.coefficients.max_degree();
        bail!("{}: the model goes to degree {has}, --degree {degree} is above it", cli.model.display());
    }
    let (directions, faces) = match (&cli.sampling.sphere, cli.sampling.icosphere) {
        (Some(path), _) => {
            let sphere = read_sphere(path, &console)?;
            (sphere.directions, sphere.faces)
        }
        (None, Some(subdivisions)) => {
            let sphere = icosphere(subdivisions);
            (Directions::from_vertices(&sphere.vertices)?, sphere.faces)
        }
        (None, None) => (
            Directions::from_unit_vectors(model.directions.clone()).with_context(|| cli.model.display().to_string())?,
            model.faces.clone(),
        ),
    };
    console.note(format!("{} vertices, degree {degree}", directions.len()));
    let values = cli.threads.pool()?.install(|| synthesis(&directions, model.coefficients.up_to(degree)))?;
    let options = WriteOptions { overwrite: cli.force, double: cli.double };
    let provenance: serde_json::Value = serde_json::from_str(&model.provenance).unwrap_or_default();
    // Three channels are a surface unless the model says that they are not.
    let surface = model.coefficients.channels() == 3 && provenance["surface"].as_bool().unwrap_or(true);
    if surface {
        if faces.is_empty() {
            let of = cli.sampling.sphere.as_ref().unwrap_or(&cli.model);
            bail!("{}: this sampling has no triangles; give --icosphere N or a --sphere that is a mesh", of.display());
        }
        let vertices = values.rows().into_iter().map(|row| [row[0], row[1], row[2]]).collect();
        let mut mesh = Mesh::new(vertices, faces);
        mesh.meta.anatomical_structure_primary = provenance["anatomical_structure_primary"].as_str().map(str::to_owned);
        write_mesh(&cli.output, &mesh, &options)?;
    } else {
        let (vertices, channels) = values.dim();
        let signal = Signal::new(values.iter().copied().collect(), vertices, channels);
        write_signal(&cli.output, &signal, &options)?;
    }
    let seconds = started.elapsed().as_secs_f64();
    print(&format!("{}: {} vertices, degree {degree}, {seconds:.2} s", cli.output.display(), directions.len()))
}
