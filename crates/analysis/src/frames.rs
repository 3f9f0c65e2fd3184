//! Writes the transforms of `shape align`, and reads those of `shape align` and `shape correspond`. A transform maps
//! the frame of a member's own file to the frame of its model.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use serde::Deserialize;
use serde_json::{Value, json};
use spharm::shape::Transform;
use spharm_cli::inputs::{MOST_OWN, read_text};
use spharm_cli::paths::{model_name, shown};
use spharm_surface::Similarity;

/// Entry of a model in the transforms written by `shape align`.
#[derive(Deserialize)]
struct Aligned {
    output: String,
    object: [[f64; 3]; 3],
    scale: f64,
    translation: [f64; 3],
}

/// Entry of a member in the report written by `shape correspond`.
#[derive(Deserialize)]
struct Member {
    name: String,
    to_group: Similarity,
}

/// Returns the entry that `shape align` writes for each model: its transform, and its distances from the target before
/// and after the alignment.
pub(super) fn written(
    models: &[PathBuf],
    outputs: &[PathBuf],
    transforms: &[Transform],
    distances: &[[f64; 2]],
) -> Vec<Value> {
    let of = |((path, output), (transform, [before, after])): ((&PathBuf, &PathBuf), (&Transform, &[f64; 2]))| {
        json!({
            "model": shown(path),
            "output": shown(output),
            "rmsd_before": before,
            "rmsd_after": after,
            "parameters": transform.rotation.matrix(),
            "antipodal": transform.antipodal,
            "object": transform.similarity.orthogonal,
            "scale": transform.similarity.scale,
            "translation": transform.similarity.translation,
        })
    };
    models.iter().zip(outputs).zip(transforms.iter().zip(distances)).map(of).collect()
}

/// Reads the transforms of the models with these names, in the order of the names. A transform maps the frame of a
/// member's own file to the frame of its model.
///
/// # Errors
///
/// If the file can't be read, wasn't written by `shape align` or `shape correspond`, or has no transform for a model.
pub(super) fn read(path: &Path, names: &[String]) -> Result<Vec<Similarity>> {
    let shown = path.display();
    let text = read_text(path, "transforms", MOST_OWN)?;
    let expected = || {
        format!(
            "{shown}: expected the output of `shape align --transforms` or `shape correspond --report`, found other JSON"
        )
    };
    let value: Value = serde_json::from_str(&text).with_context(|| format!("{shown}: not JSON"))?;
    let found = match value.get("members") {
        Some(members) => of_group(members.clone()),
        None => of_alignment(value),
    };
    let found = found.with_context(expected)?;
    let one = |name: &String| match found.iter().find(|(of, _)| of == name) {
        Some((_, similarity)) => Ok(*similarity),
        None => bail!("{shown}: found no transform for {name}"),
    };
    names.iter().map(one).collect()
}

fn of_alignment(value: Value) -> serde_json::Result<Vec<(String, Similarity)>> {
    let of = |found: Aligned| {
        let Aligned { output, object: orthogonal, scale, translation } = found;
        (model_name(Path::new(&output)), Similarity { orthogonal, scale, translation })
    };
    Ok(serde_json::from_value::<Vec<Aligned>>(value)?.into_iter().map(of).collect())
}

fn of_group(value: Value) -> serde_json::Result<Vec<(String, Similarity)>> {
    let members: Vec<Member> = serde_json::from_value(value)?;
    Ok(members.into_iter().map(|found| (found.name, found.to_group)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transforms_are_found_by_their_models() {
        let site = tempfile::tempdir().unwrap();
        let path = site.path().join("t.json");
        let parts =
            |turn: &str| format!("{{\"{turn}\":[[0,-1,0],[1,0,0],[0,0,1]],\"scale\":2,\"translation\":[1,0,0]}}");
        let aligned = parts("object").replace('{', "{\"output\":\"o/b.spharm.npz\",\"rmsd_after\":1,");
        let member = format!("{{\"members\":[{{\"name\":\"b\",\"to_group\":{}}}]}}", parts("orthogonal"));
        for text in [format!("[{aligned}]"), member] {
            std::fs::write(&path, text).unwrap();
            let found = read(&path, &["b".to_owned()]).unwrap();
            assert_eq!(found[0].apply([1.0, 0.0, 3.0]), [1.0, 2.0, 6.0]);
            assert!(read(&path, &["a".to_owned()]).unwrap_err().to_string().contains("found no transform for a"));
        }
        std::fs::write(&path, "{\"a\": 1}").unwrap();
        assert!(read(&path, &[]).unwrap_err().to_string().contains("found other JSON"));
    }
}
