//! `compare`: measures the distance between two meshes, vertex by vertex and between the surfaces.

mod args;
mod frames;
mod output;

use anyhow::{Context, Result, bail};
use spharm_cli::memory::{Budget, round_numbers_below};
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{OutputFile, check_outputs, is_stdout, prepare, print, print_json, table, write_json};
use spharm_surface::Mesh;
use spharm_surface::io::{CoarseNumbers, PAINTED, PlyAttributes, WriteOptions, read_mask, write_painted};
use spharm_surface::metrics::{
    SurfaceDistanceParams, Unpaired, colors, compare_at, correspond, distances_to_surface, distances_to_surface_bytes,
    surface_distance_at, surface_distance_bytes, vertex_distances,
};

pub(crate) use self::args::Cli;
use self::output::{Report, rows};
use crate::surfaces::Surface;

/// Runs the verb.
pub(crate) fn run(cli: &Cli) -> Result<()> {
    let painted = cli.output.as_deref().map(|path| OutputFile::with_ending(path, "--output", PAINTED));
    let report = cli.report.as_deref().map(|path| OutputFile::new(path, "--report"));
    check_outputs(painted.into_iter().chain(report), cli.force)?;
    cli.threads.pool()?.install(|| work(cli))
}

/// Returns the memory that both meshes occupy, in bytes.
fn held(meshes: [&Mesh; 2]) -> u64 {
    meshes.map(|mesh| 24 * mesh.vertices.len() + 12 * mesh.faces.len()).iter().sum::<usize>() as u64
}

/// Refuses a comparison that doesn't fit into memory.
fn check_memory(
    cli: &Cli,
    surface_distance: bool,
    original: &Mesh,
    reconstruction: &Mesh,
    budget: Budget,
) -> Result<()> {
    let held = held([original, reconstruction]);
    // Memory for squared distances, distances and colours.
    let at_vertices = 20 * reconstruction.vertices.len() as u64;
    if !surface_distance {
        return budget.check(format_args!("compare {}", cli.original.display()), held + at_vertices);
    }
    let painting = match cli.output {
        Some(_) => distances_to_surface_bytes(original.faces.len(), reconstruction.vertices.len()) + at_vertices,
        None => at_vertices,
    };
    let needed = |samples: usize| {
        let distance = surface_distance_bytes(original, reconstruction, &SurfaceDistanceParams { samples });
        held + distance.max(painting)
    };
    let fewer = round_numbers_below(cli.samples as u64);
    let fewer = fewer.map(|samples| (format!("--samples {samples}"), needed(samples as usize)));
    budget.check_or(format_args!("compare --surface-distance --samples {}", cli.samples), needed(cli.samples), fewer)
}

fn work(cli: &Cli) -> Result<()> {
    let monitor = ConsoleMonitor::new(cli.common.console());
    let budget = cli.memory.budget(cli.threads.count());
    budget.check_inputs("compare", [cli.original.as_path(), &cli.reconstruction])?;
    let [first, second] = [Surface::read(&cli.original)?.finest(), Surface::read(&cli.reconstruction)?.finest()];
    for (surface, path) in [(&first, &cli.original), (&second, &cli.reconstruction)] {
        if let Some(text) = surface.cut_handles() {
            monitor.console().warn(format!("{}: {text}", path.display()));
        }
    }
    // A model is evaluated at the vertices of an icosphere. These vertices have no counterparts in a mesh, so the
    // distance between the surfaces is measured instead.
    let surface_distance = cli.surface_distance || first.is_model() || second.is_model();
    let evaluating = first.bytes_to_evaluate().max(second.bytes_to_evaluate());
    budget.check(format_args!("compare {}", cli.original.display()), evaluating)?;
    let apart = first.mapped_apart(&second);
    let [original, reconstruction] = [first.into_mesh()?, second.into_mesh()?];
    check_memory(cli, surface_distance, &original, &reconstruction, budget)?;
    // Search for vertices that don't correspond only if the search fits into memory.
    let has_room = budget.fits(held([&original, &reconstruction]) + Unpaired::bytes(reconstruction.faces.len()));
    let pair = || format!("{} and {}", cli.original.display(), cli.reconstruction.display());
    // If neither --mask nor --surface-distance is given, `compare_at` itself refuses meshes with different triangles.
    let corresponds = !apart && (cli.mask.is_some() || surface_distance) && correspond(&original, &reconstruction);
    let mask = cli.mask.as_ref().map(|path| read_mask(path, original.vertices.len())).transpose()?;
    let mask = mask.as_deref();
    if apart {
        let text = "the models' surfaces were mapped separately, so equal directions don't correspond; only the distance \
                    between the surfaces is measured";
        monitor.console().note(text);
    }
    if frames::differ_by_centre(&original, &reconstruction) {
        monitor.console().note(format!(
            "{}: the surfaces are shifted by the centre of their volume (c_ras): one is in FreeSurfer's surface \
             coordinates (tkRAS), the other in scanner coordinates; convert one of them first, for example by \
             mris_convert --to-scanner",
            pair()
        ));
    }
    if mask.is_some() && apart {
        bail!(
            "{}: --mask compares points in equal directions, which don't correspond if surfaces were mapped separately",
            pair()
        );
    }
    if mask.is_some() && !corresponds {
        bail!("{}: --mask compares the same vertices of both surfaces, so both need the same triangles", pair());
    }
    let surfaces = if surface_distance {
        let params = SurfaceDistanceParams { samples: cli.samples };
        Some(surface_distance_at(&original, &reconstruction, mask, &params, &monitor).with_context(pair)?)
    } else {
        None
    };
    // Meshes with different numbers of vertices or different triangles are an error, unless the distance between the
    // surfaces is measured.
    let vertexwise = if surfaces.is_none() || corresponds {
        Some(compare_at(&original, &reconstruction, mask).with_context(pair)?)
    } else {
        None
    };
    if let Some(vertexwise) = vertexwise.as_ref().filter(|_| surfaces.is_none() && has_room) {
        let found = Unpaired::of(&original, &reconstruction, mask, vertexwise).with_context(pair)?;
        found.iter().for_each(|found| monitor.console().warn(format!("{}: {found}", pair())));
    }
    if let Some(output) = &cli.output {
        let distances = match surfaces {
            Some(_) => distances_to_surface(&original, &reconstruction.vertices, &monitor)?,
            None => vertex_distances(&original.vertices, &reconstruction.vertices)?,
        };
        let largest = distances.iter().copied().fold(0.0, f64::max);
        let painted = colors(&distances, 0.0, cli.range.unwrap_or(largest));
        let attributes = PlyAttributes { scalar: Some(("distance", &distances)), colors: Some(&painted) };
        let options = WriteOptions { overwrite: cli.force, ..WriteOptions::default() };
        prepare(output)?;
        // A .gii file has only the distances.
        let name = output.to_string_lossy().to_lowercase();
        if !name.trim_end_matches(".gz").ends_with(".gii") {
            let coarse = CoarseNumbers::of(output, &reconstruction, &options)?;
            coarse.iter().for_each(|coarse| monitor.console().warn(coarse.with_option(None)));
        }
        write_painted(output, &reconstruction, &attributes, &options)?;
    }
    let vertices = mask.map_or(original.vertices.len(), |mask| mask.iter().filter(|keep| **keep).count());
    let report = Report::new(vertices, vertexwise, surfaces);
    if let Some(path) = &cli.report {
        write_json(path, cli.force, &report)?;
    }
    if cli.report.as_deref().is_some_and(is_stdout) {
        return Ok(());
    }
    if cli.json { print_json(&report) } else { print(&table(&rows(&report))) }
}
