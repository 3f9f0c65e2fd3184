//! What would be done: rows, models that exist, spheres, memory.

use std::path::Path;

use anyhow::Result;
use serde_json::json;
use spharm::{check_memory, read_sphere};
use spharm_cli::output::{counted, print, print_json};
use spharm_cli::size::Size;

use super::groups::groups;
use super::options::{Options, Rows};

/// Spheres that are read for their sizes.
const READ: usize = 3;
/// Surfaces that are named where they are missing.
const NAMED: usize = 5;

/// Prints what a call would do. Models are looked for, and inputs; a few spheres are read.
pub(super) fn run(rows: &Rows, options: &Options) -> Result<()> {
    let numbers: Vec<usize> = (0..rows.rows.len()).collect();
    let groups = groups(&rows.rows, &numbers);
    let exist = rows.rows.iter().filter(|row| row.model(&rows.folder).exists()).count();
    let missing: Vec<&Path> = rows.rows.iter().map(|row| row.surface.as_path()).filter(|path| !path.exists()).collect();
    let spheres = groups.iter().filter(|group| group.sphere.is_some()).count();
    let own: usize = groups.iter().filter(|group| group.sphere.is_none()).map(|group| group.rows.len()).sum();
    let budget = options.params.memory_budget();
    let mut vertices = Vec::new();
    for group in &groups {
        let Some(path) = group.sphere.as_deref().filter(|_| vertices.len() < READ) else { continue };
        let sphere = match &rows.sphere {
            Some(sphere) => sphere.clone(),
            None => read_sphere(path)?,
        };
        check_memory(&sphere.to_mesh(), &options.params)?;
        vertices.push((path, group.rows.len(), sphere.directions.len()));
    }
    if options.json {
        let spheres: Vec<_> =
            vertices.iter().map(|(path, rows, n)| json!({ "sphere": path, "rows": rows, "vertices": n })).collect();
        return print_json(&json!({
            "rows": rows.rows.len(), "exist": exist, "missing": missing.len(), "spheres": groups.len() - own.min(1),
            "first_spheres": spheres, "mapped": own, "memory": budget,
        }));
    }
    let mut lines = vec![format!("{}, of which {exist} exist", counted(rows.rows.len(), "model"))];
    lines.push(match (spheres, own) {
        (0, _) => "each surface is mapped to a sphere of its own".to_owned(),
        (_, 0) => format!("over {}", counted(spheres, "sphere")),
        _ => format!(
            "over {}; {} to spheres of their own",
            counted(spheres, "sphere"),
            if own == 1 { "1 surface is mapped".to_owned() } else { format!("{own} surfaces are mapped") }
        ),
    });
    let size = |(path, rows, n): &(&Path, usize, usize)| {
        format!("  {}: {n} vertices, {}", path.display(), counted(*rows, "surface"))
    };
    lines.extend(vertices.iter().map(size));
    if spheres > vertices.len() {
        lines.push(format!("  and {} more", spheres - vertices.len()));
    }
    lines.push(format!("within {} of memory", Size(budget)));
    if !missing.is_empty() {
        lines.push(format!(
            "{} not there:",
            if missing.len() == 1 { "1 surface is".to_owned() } else { format!("{} surfaces are", missing.len()) }
        ));
        lines.extend(missing.iter().take(NAMED).map(|path| format!("  {}", path.display())));
        if missing.len() > NAMED {
            lines.push(format!("  and {} more", missing.len() - NAMED));
        }
    }
    print(&lines.join("\n"))
}
