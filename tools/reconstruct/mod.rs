//! `reconstruct`: evaluates models on any sampling of the sphere.

mod args;
mod outputs;

use std::time::Instant;

use anyhow::{Context, Result, bail};
use spharm_cli::console::Console;
use spharm_cli::inputs::read_sphere;
use spharm_cli::machine::available_memory;
use spharm_cli::output::{prepare, print_line};
use spharm_cli::size::Size;
use spharm_model::Model;
use spharm_surface::io::{Output, WriteOptions, check_output, write_mesh, write_signal};
use spharm_surface::metrics::bounding_box_scale;
use spharm_surface::{Kind, Mesh, Seam, Sphere, Welded};

pub(crate) use self::args::Cli;
use self::outputs::{Item, items};

/// Runs the verb.
pub(crate) fn run(cli: &Cli) -> Result<()> {
    let console = cli.common.console();
    let items = items(cli)?;
    let shared = shared_sphere(cli, &console)?;
    let pool = cli.threads.pool()?;
    items.iter().try_for_each(|item| pool.install(|| one(cli, item, shared.as_ref(), &console)))
}

/// The sampling that all models are evaluated on, unless each has its own.
fn shared_sphere(cli: &Cli, console: &Console) -> Result<Option<Sphere>> {
    match (&cli.sampling.sphere, cli.sampling.icosphere) {
        (Some(path), _) => Ok(Some(read_sphere(path, false, console)?)),
        (None, Some(subdivisions)) => {
            // Of models whose channels aren't known yet.
            check_memory(cli, 10 * (1 << (2 * subdivisions)) + 2, 1, console)?;
            Ok(Some(Sphere::icosphere(subdivisions)))
        }
        (None, None) => Ok(None),
    }
}

/// Says what a large reconstruction takes, and refuses what there is no memory for.
fn check_memory(cli: &Cli, vertices: usize, channels: usize, console: &Console) -> Result<()> {
    /// Directions and triangles.
    const BYTES_PER_VERTEX: usize = 56;
    /// The values, as they are computed, as a mesh or signal, and while they are written.
    const BYTES_PER_VALUE: usize = 24;
    /// Below this nobody has to know.
    const LARGE: usize = 1 << 30;
    let needed = Size(vertices * (BYTES_PER_VERTEX + BYTES_PER_VALUE * channels));
    let limit = cli.memory.unwrap_or(Size(available_memory()));
    if needed > limit {
        let limit = if cli.memory.is_some() { format!("--memory is {limit}") } else { format!("{limit} are free") };
        bail!("{vertices} vertices take about {needed} of memory, {limit}; choose a coarser sphere, or raise --memory");
    }
    if needed.0 >= LARGE {
        console.note(format!("{vertices} vertices take about {needed} of memory"));
    }
    Ok(())
}

fn one(cli: &Cli, item: &Item, shared: Option<&Sphere>, console: &Console) -> Result<()> {
    let started = Instant::now();
    let model = Model::read(&item.model)?;
    let highest = model.coefficients.max_degree();
    let degree = cli.max_degree.unwrap_or(highest);
    if degree > highest {
        bail!("{}: the model goes to degree {highest}, --max-degree {degree} is above it", item.model.display());
    }
    let named = || item.model.display().to_string();
    let sphere = match shared {
        Some(sphere) => sphere,
        None => model.own_sphere().with_context(named)?,
    };
    let mut vertices = sphere.directions.len();
    check_memory(cli, vertices, model.coefficients.channels(), console)?;
    console.detail(format!("{}: {vertices} vertices, degree {degree}", named()));
    let options = WriteOptions { overwrite: cli.force, double: cli.double };
    let surface = model.kind() == Kind::Surface;
    let output = item.output(surface);
    check_output(&output, if surface { Output::Mesh } else { Output::Signal })?;
    if surface {
        if sphere.faces.is_empty() {
            let sampling = shared.map_or(item.model.as_path(), Sphere::name);
            bail!(
                "{}: this sampling has no triangles; give --icosphere N or a --sphere that is a mesh",
                sampling.display()
            );
        }
        let mesh = match shared {
            Some(sphere) => model.reconstruct(sphere, degree).with_context(named)?,
            None => original(&model, degree, console).with_context(named)?,
        };
        vertices = mesh.vertices.len();
        prepare(&output)?;
        write_mesh(&output, &mesh, &options)?;
    } else {
        let signal = model.reconstruct_signal(sphere, degree).with_context(named)?;
        prepare(&output)?;
        write_signal(&output, &signal, &options)?;
    }
    let seconds = started.elapsed().as_secs_f64();
    print_line(&format!("{}: {vertices} vertices, degree {degree}, {seconds:.2} s", output.display()))
}

/// The surface at the vertices that were fitted, with its handles where they were cut.
fn original(model: &Model, degree: usize, console: &Console) -> Result<Mesh> {
    let Welded { mesh, gap } = model.reconstruct_original(degree)?;
    let seam = model.sphere.as_ref().and_then(|sphere| sphere.seam.as_ref());
    if let Some(Seam { copies, .. }) = seam {
        let share = bounding_box_scale(&mesh.vertices).map(|scale| format!(" ({:.2e} of the box)", gap / scale));
        console.note(format!(
            "{} of the surface's vertices on the seams, where its handles were cut, are welded; they were up to {gap:.2e} \
             apart{}",
            copies.len(),
            share.unwrap_or_default()
        ));
    }
    Ok(mesh)
}
