//! `reconstruct`: evaluates models on any sampling of the sphere.

mod args;
mod outputs;

use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use serde_json::{Value, json};
use spharm_cli::console::Console;
use spharm_cli::inputs::read_sphere;
use spharm_cli::memory::Budget;
use spharm_cli::models::cut_handles;
use spharm_cli::output::{prepare, print_json, print_line};
use spharm_cli::paths::shown;
use spharm_cli::size::Size;
use spharm_model::Model;
use spharm_monitor::number;
use spharm_surface::generate::{icosphere_bytes, icosphere_counts};
use spharm_surface::io::{
    CoarseNumbers, Precision, WriteOptions, bytes_to_read, to_write_mesh, to_write_signal, write_mesh, write_signal_of,
};
use spharm_surface::metrics::bounding_box_scale;
use spharm_surface::{Kind, Mesh, Seam, Sphere, TargetWarning, Welded};

pub(crate) use self::args::Cli;
use self::outputs::{Item, items};

/// Runs the verb.
pub(crate) fn run(cli: &Cli) -> Result<()> {
    let console = cli.common.console();
    let items = items(cli)?;
    let budget = cli.memory.budget(cli.threads.count());
    let shared = shared_sphere(cli, budget, &console)?;
    let pool = cli.threads.pool()?;
    let mut made = Vec::with_capacity(items.len());
    for item in &items {
        made.push(pool.install(|| one(cli, item, shared.as_ref(), budget, &console))?);
    }
    if cli.json {
        print_json(&json!({ "tool": "reconstruct", "versions": spharm::versions(), "outputs": made }))
    } else {
        Ok(())
    }
}

/// Returns the sphere on which all models are evaluated, or `None` if each model is evaluated on its own sphere.
fn shared_sphere(cli: &Cli, budget: Budget, console: &Console) -> Result<Option<Sphere>> {
    match (&cli.sampling.sphere, cli.sampling.icosphere) {
        (Some(path), _) => {
            budget.check_inputs("reconstruct", [path.as_path()])?;
            Ok(Some(read_sphere(path, false, console)?))
        }
        (None, Some(subdivisions)) => {
            // Use a lower bound of the memory, because the models haven't been read yet.
            let smallest = |subdivisions| on_icosphere(subdivisions, 1, 0);
            let fewer = (0..subdivisions).rev().map(|fewer| (format!("--icosphere {fewer}"), smallest(fewer)));
            let vertices = icosphere_counts(subdivisions)[0];
            let what = format!("reconstruct --icosphere {subdivisions} ({vertices} vertices)");
            budget.check_or(what, smallest(subdivisions), fewer)?;
            Ok(Some(Sphere::icosphere(subdivisions)))
        }
        (None, None) => Ok(None),
    }
}

/// Returns the memory, in bytes, for an icosphere and for a model's values at the icosphere's vertices.
fn on_icosphere(subdivisions: u32, channels: usize, degree: usize) -> u64 {
    let [vertices, faces] = icosphere_counts(subdivisions);
    icosphere_bytes(subdivisions).max(Model::bytes_to_evaluate(vertices, faces, channels, degree))
}

/// Reports the memory that a large reconstruction needs, and refuses a reconstruction that doesn't fit.
fn check_memory(
    cli: &Cli,
    (sphere, degree): (&Sphere, usize),
    (model, path): (&Model, &Path),
    budget: Budget,
    console: &Console,
) -> Result<()> {
    /// Smallest memory requirement that is reported, in bytes.
    const LARGE: u64 = 1 << 30;
    let (vertices, channels) = (sphere.directions.len(), model.coefficients.channels());
    // Memory of the model as read from its file, including the model's own sphere.
    let held = bytes_to_read(path);
    let of = |vertices, faces| held.saturating_add(Model::bytes_to_evaluate(vertices, faces, channels, degree));
    let needed = of(vertices as u64, sphere.faces.len() as u64);
    let most = cli.sampling.icosphere.unwrap_or(13).min(13);
    let fewer = (0..most).rev().map(|fewer| (fewer, icosphere_counts(fewer)));
    let fewer = fewer.filter(|(_, [count, _])| *count < vertices as u64);
    let fewer = fewer.map(|(fewer, [vertices, faces])| (format!("--icosphere {fewer}"), of(vertices, faces)));
    budget.check_or(format_args!("{}: evaluating the model at {vertices} vertices", path.display()), needed, fewer)?;
    if needed >= LARGE {
        console.note(format!("{vertices} vertices take about {} of memory", Size(needed as usize)));
    }
    Ok(())
}

/// Evaluates one model and writes the result. Returns the report on this model.
fn one(cli: &Cli, item: &Item, shared: Option<&Sphere>, budget: Budget, console: &Console) -> Result<Value> {
    let started = Instant::now();
    budget.check_inputs("reconstruct", [item.model.as_path()])?;
    let model = Model::read(&item.model)?;
    let highest = model.coefficients.max_degree();
    let degree = cli.max_degree.unwrap_or(highest);
    if degree > highest {
        bail!("{}: --max-degree {degree} exceeds the model's degree {highest}", item.model.display());
    }
    let named = || item.model.display().to_string();
    let sphere = match shared {
        Some(sphere) => sphere,
        None => model.own_sphere().with_context(named)?,
    };
    if let Some(given) = shared {
        warn_of_hemispheres(&model, &item.model, given, console);
        // No warning is needed on the model's own sphere, because the caps that fill the cuts are omitted there.
        if let Some(text) = cut_handles(&model).filter(|_| model.kind() == Kind::Surface) {
            console.warn(format!("{}: {text}", named()));
        }
    }
    let mut vertices = sphere.directions.len();
    check_memory(cli, (sphere, degree), (&model, &item.model), budget, console)?;
    console.detail(format!("{}: {vertices} vertices, degree {degree}", named()));
    let options = WriteOptions { overwrite: cli.force, double: cli.double };
    let surface = model.kind() == Kind::Surface;
    let output = item.output(surface);
    let format = if surface { to_write_mesh(&output)? } else { to_write_signal(&output)? };
    if cli.double && format.precision == Precision::Single {
        let (path, name) = (output.display(), format.name);
        console.warn(format!("{path}: --double has no effect, because {name} stores 32-bit numbers"));
    }
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
        let coarse = CoarseNumbers::of(&output, &mesh, &options)?;
        coarse.iter().for_each(|coarse| console.warn(coarse.with_option(Some("give --double"))));
        prepare(&output)?;
        write_mesh(&output, &mesh, &options)?;
    } else {
        let signal = model.reconstruct_signal(sphere, degree).with_context(named)?;
        prepare(&output)?;
        write_signal_of(&output, &signal, model.anatomical_structure().as_deref(), &options)?;
    }
    let seconds = started.elapsed().as_secs_f64();
    if !cli.json {
        print_line(&format!("{}: {vertices} vertices, degree {degree}, {seconds:.2} s", output.display()))?;
    }
    Ok(json!({
        "model": shown(&item.model),
        "output": shown(&output),
        "vertices": vertices,
        "degree": degree,
        "seconds": seconds,
    }))
}

/// Warns if a model and the sphere at whose vertices it is evaluated belong to different hemispheres.
fn warn_of_hemispheres(model: &Model, path: &Path, sphere: &Sphere, console: &Console) {
    if let (Some(target), Some(sphere)) = (model.hemisphere(Some(path)), sphere.hemisphere())
        && target != sphere
    {
        console.warn(format!("{}: {}", path.display(), TargetWarning::OtherHemisphere { target, sphere }));
    }
}

/// Largest gap between the two sides of a seam, as a fraction of the bounding box's size, that gives no warning.
const WIDE: f64 = 5e-3;

/// Returns the surface at the fitted vertices, with its handles restored if they were cut.
fn original(model: &Model, degree: usize, console: &Console) -> Result<Mesh> {
    let Welded { mesh, gap } = model.reconstruct_original(degree)?;
    let seam = model.sphere.as_ref().and_then(|sphere| sphere.seam.as_ref());
    if let Some(Seam { copies, .. }) = seam {
        let share = bounding_box_scale(&mesh.vertices).ok().map(|scale| gap / scale);
        let of_box = share.map(|share| format!(" ({} of the bounding box)", number(share))).unwrap_or_default();
        let text = format!(
            "welded {} vertices on the seams where handles were cut; before welding, copies of a vertex were up to {} \
             apart{of_box}",
            copies.len(),
            number(gap),
        );
        match share {
            Some(share) if share > WIDE => console.warn(format!("{text}; a model of a higher degree reduces this gap")),
            _ => console.note(text),
        }
    }
    Ok(mesh)
}
