//! Tests the reading of SPHARM-PDM's meshes.

use spharm_surface::SurfaceError;
use spharm_surface::io::{read_mesh, write_mesh};

const HEAD: &str = "ObjectType = Scene\nNDims = 3\nNObjects = 1\nObjectType = Mesh\nNDims = 3\nBinaryData = False\n\
                    TransformMatrix = 1 0 0 0 1 0 0 0 1\nOffset = 0 0 0\nElementSpacing = 1 1 1\nPointType = MET_FLOAT\n\
                    NCellTypes = 1\nPointDim = ID x y ...\n";
const POINTS: &str = "NPoints = 4\nPoints = \n10 0 0 0 \n11 1 0 0 \n12 0 1 0 \n13 0 0 1 \n\n";
const CELLS: &str = "CellType = TRI\nNCells = 4\nCells = \n0 10 12 11 \n1 10 11 13 \n2 11 12 13 \n3 12 10 13 \n\n";

fn read(text: &str) -> Result<spharm_surface::Mesh, SurfaceError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.meta");
    std::fs::write(&path, text).unwrap();
    read_mesh(&path)
}

#[test]
fn points_go_by_their_numbers() {
    let mesh = read(&[HEAD, POINTS, CELLS].concat()).unwrap();
    assert_eq!(mesh.vertices, [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
    assert_eq!(mesh.faces, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]);
    // Cells that aren't polygons are skipped.
    let lines = "CellType = LNE\nNCells = 1\nCells = \n0 10 11\n";
    assert_eq!(read(&[HEAD, POINTS, lines, CELLS].concat()).unwrap(), mesh);
}

#[test]
fn what_is_not_understood_is_refused() {
    for (text, why) in [
        (HEAD.replace("False", "True") + POINTS + CELLS, "BinaryData = False"),
        (HEAD.replace("ElementSpacing = 1 1 1", "ElementSpacing = 2 1 1") + POINTS + CELLS, "ElementSpacing"),
        (HEAD.replace("Offset = 0 0 0", "Offset = 0 1 0") + POINTS + CELLS, "Offset"),
        (HEAD.replace("= Mesh", "= Tube") + POINTS + CELLS, "Tube"),
        ([HEAD, &POINTS.replace("= 4", "= 99999999999"), CELLS].concat(), "99999999999 points"),
        ([HEAD, POINTS, &CELLS.replace("12 11", "12 99")].concat(), "a point's number on line"),
        ([HEAD, POINTS, &CELLS.replace("NCells = 4", "NCells = 77777777777")].concat(), "77777777777 cells"),
        ([HEAD, &POINTS.replace("12 0 1 0", "12 0 x 0")].concat(), "coordinate"),
    ] {
        let error = read(&text).unwrap_err().to_string();
        assert!(error.contains(why) && error.contains("a.meta"), "{why}: {error}");
    }
    let whole = [HEAD, POINTS, CELLS].concat();
    for length in 0..whole.len() - 2 {
        let _ = read(&whole[..length]);
    }
}

/// A surface and its parameterisation in files of SPHARM-PDM have the same triangles; the surface is wound outwards.
#[test]
fn a_genuine_pair_corresponds() {
    let names = ["peers/a01_l_hippo.surf.meta", "peers/a01_l_hippo.para.meta"];
    let [Some(surface), Some(sphere)] = names.map(spharm_testdata::shared) else { return };
    let (surface, sphere) = (read_mesh(surface).unwrap(), read_mesh(sphere).unwrap());
    assert_eq!((surface.vertices.len(), surface.faces.len()), (3856, 7708));
    assert_eq!(surface.faces, sphere.faces);
    assert!(spharm_surface::topology::Topology::of(&surface).is_sphere());
    assert!(sphere.vertices.iter().all(|v| (v.iter().map(|x| x * x).sum::<f64>() - 1.0).abs() < 1e-4));
    let error = write_mesh("a.meta", &surface, &spharm_surface::io::WriteOptions::default()).unwrap_err();
    assert!(matches!(error, SurfaceError::UnknownFormat { .. }), "{error}");
}
