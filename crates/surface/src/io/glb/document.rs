//! Parses the JSON of a file: only meshes and their placement (section 5 of the specification).

use std::collections::HashMap;

use serde::Deserialize;
use serde::de::IgnoredAny;

use super::super::flaw::Flaw;

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct Document {
    pub(super) asset: Asset,
    extensions_required: Vec<String>,
    pub(super) scene: Option<usize>,
    pub(super) scenes: Vec<Scene>,
    pub(super) nodes: Vec<Node>,
    pub(super) meshes: Vec<Mesh>,
    pub(super) accessors: Vec<Accessor>,
    pub(super) buffer_views: Vec<BufferView>,
    pub(super) buffers: Vec<BufferHead>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Asset {
    version: String,
    pub(super) generator: String,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Scene {
    pub(super) nodes: Vec<usize>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Node {
    pub(super) children: Vec<usize>,
    pub(super) mesh: Option<usize>,
    skin: Option<usize>,
    weights: Vec<f64>,
    pub(super) matrix: Option<[f64; 16]>,
    pub(super) translation: Option<[f64; 3]>,
    pub(super) rotation: Option<[f64; 4]>,
    pub(super) scale: Option<[f64; 3]>,
    extensions: HashMap<String, IgnoredAny>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Mesh {
    pub(super) primitives: Vec<Primitive>,
    weights: Vec<f64>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Primitive {
    pub(super) attributes: HashMap<String, usize>,
    pub(super) indices: Option<usize>,
    /// Kind of primitive: points, lines, triangles, strips or fans. An absent mode means 4 (triangles).
    pub(super) mode: Option<u64>,
    extensions: HashMap<String, IgnoredAny>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct Accessor {
    pub(super) buffer_view: Option<usize>,
    pub(super) byte_offset: u64,
    pub(super) component_type: u64,
    pub(super) normalized: bool,
    pub(super) count: u64,
    #[serde(rename = "type")]
    pub(super) kind: String,
    pub(super) sparse: Option<Sparse>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Sparse {
    pub(super) count: u64,
    pub(super) indices: SparsePart,
    pub(super) values: SparsePart,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct SparsePart {
    pub(super) buffer_view: usize,
    #[serde(default)]
    pub(super) byte_offset: u64,
    /// Code of the indices' number type, if this part has the indices of a sparse accessor. Absent (0) if this part has
    /// the values, because the values have the accessor's number type.
    #[serde(default)]
    pub(super) component_type: u64,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct BufferView {
    pub(super) buffer: usize,
    pub(super) byte_offset: u64,
    pub(super) byte_length: u64,
    pub(super) byte_stride: Option<u64>,
    extensions: HashMap<String, IgnoredAny>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct BufferHead {
    pub(super) uri: Option<String>,
    pub(super) byte_length: u64,
}

/// Name of the generator in files written by this crate.
pub(super) const GENERATOR: &str = "spharm";
/// The extension that allows positions as integers.
const QUANTIZATION: &str = "KHR_mesh_quantization";
/// Extensions that compress meshes. They aren't supported; `UNCOMPRESSED` is the advice in error messages.
const COMPRESSIONS: [&str; 3] = ["KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression"];
const UNCOMPRESSED: &str = "export the scene again without mesh compression";
/// Prefixes of the names of extensions that affect only the appearance of a surface.
const LOOKS: [&str; 6] =
    ["KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_", "EXT_lights_", "KHR_xmp_json_ld"];

impl Document {
    /// Parses the JSON. Rejects a file that requires an unsupported extension.
    pub(super) fn parse(json: &[u8]) -> Result<Self, Flaw> {
        let document: Self =
            serde_json::from_slice(json).map_err(|e| Flaw::new("valid JSON of a glTF scene", e.to_string()))?;
        let version = &document.asset.version;
        if !version.starts_with("2.") {
            return match version.as_str() {
                "" => Err(Flaw::new("the glTF version in \"asset\"", "none")),
                _ => Err(Flaw::unsupported(format!("version {version} of glTF"), "export the scene as glTF 2.0")),
            };
        }
        for name in &document.extensions_required {
            let name = name.as_str();
            if COMPRESSIONS.contains(&name) {
                return Err(Flaw::unsupported(format!("the compression {name}"), UNCOMPRESSED));
            }
            if name != QUANTIZATION && !LOOKS.iter().any(|start| name.starts_with(start)) {
                return Err(Flaw::unsupported(
                    format!("the extension {name}"),
                    "export the scene again without extensions",
                ));
            }
        }
        Ok(document)
    }

    /// Returns whether positions may be integers.
    pub(super) fn is_quantized(&self) -> bool {
        self.extensions_required.iter().any(|name| name == QUANTIZATION)
    }

    /// Rejects a node and its mesh if bones, shape keys or instances change the stored positions.
    pub(super) fn check_rigid(&self, node: &Node, mesh: &Mesh) -> Result<(), Flaw> {
        let weights = if node.weights.is_empty() { &mesh.weights } else { &node.weights };
        let found = if node.skin.is_some() {
            "a mesh deformed by bones (a skin)"
        } else if weights.iter().any(|&weight| weight != 0.0) {
            "a mesh with active shape keys (morph targets)"
        } else if node.extensions.contains_key("EXT_mesh_gpu_instancing") {
            "instances of a mesh (EXT_mesh_gpu_instancing)"
        } else {
            return Ok(());
        };
        Err(Flaw::unsupported(found, "apply the mesh's modifiers and export the mesh alone"))
    }
}

impl Primitive {
    /// Returns the error for an array without data. If the data are compressed, the error names the compression.
    pub(super) fn without_data(&self) -> Flaw {
        compressed(&self.extensions).unwrap_or_else(|| Flaw::new("data for each accessor", "none"))
    }
}

impl BufferView {
    /// Returns the error for a view whose buffer has no bytes. If the data are compressed, the error names the
    /// compression.
    pub(super) fn without_data(&self) -> Flaw {
        compressed(&self.extensions).unwrap_or_else(|| Flaw::new("bytes in each buffer", "none"))
    }
}

fn compressed(extensions: &HashMap<String, IgnoredAny>) -> Option<Flaw> {
    let name = COMPRESSIONS.iter().find(|&&name| extensions.contains_key(name))?;
    Some(Flaw::unsupported(format!("the compression {name}"), UNCOMPRESSED))
}
