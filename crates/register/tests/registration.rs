//! Tests registrations of generated surfaces whose correspondence is known.

use spharm_monitor::Silent;
use spharm_register::{
    Guide, RegisterError, RegisterParams, Registered, Subject, Template, register, without_counterpart,
};
use spharm_surface::generate::icosphere;
use spharm_surface::geometry::{Vec3, dot, sub};
use spharm_surface::{Mesh, Place};

/// Returns a box with round edges and a bump on its top; `at`, from -1 to 1, is the bump's position along the box.
fn with_bump(level: u32, at: f64, turn: f64) -> Mesh {
    let (s, c) = turn.sin_cos();
    let mesh = icosphere(level);
    let place = |u: &Vec3| {
        let u = [c * u[0] - s * u[1], s * u[0] + c * u[1], u[2]];
        let half = [15.0, 8.0, 6.0];
        let sum: f64 = (0..3).map(|k| (u[k] / half[k]).abs().powi(6)).sum();
        let mut v = u.map(|x| x * sum.powf(-1.0 / 6.0));
        let off = (v[0] - 6.0 * at).powi(2) + v[1].powi(2);
        v[2] += (v[2] / 6.0).max(0.0).powi(4) * 4.0 * (-off / 18.0).exp();
        v
    };
    mesh.with_vertices(mesh.vertices.iter().map(place).collect())
}

fn prepared(mesh: &Mesh) -> Template {
    Template::new(mesh, None, &RegisterParams::default(), &Silent).unwrap()
}

fn moved(template: &Template, subject: &Mesh) -> Registered {
    let subject = Subject::new(subject).unwrap();
    register(template, &subject, &[], &RegisterParams::default(), &Silent).unwrap()
}

fn root_mean_square(a: &[Vec3], b: &[Vec3]) -> f64 {
    let sum: f64 = a.iter().zip(b).map(|(a, b)| dot(sub(*a, *b), sub(*a, *b))).sum();
    (sum / a.len() as f64).sqrt()
}

#[test]
fn a_surface_is_registered_to_itself_by_staying_where_it_is() {
    let mesh = with_bump(4, 0.3, 0.0);
    let found = moved(&prepared(&mesh), &mesh);
    assert!(root_mean_square(&found.vertices, &mesh.vertices) < 0.25, "{:?}", found.cover);
    assert_eq!(found.turned, 0);
    assert!(found.reached.iter().all(|reached| *reached));
}

#[test]
fn a_bump_that_moved_keeps_its_top() {
    let template = with_bump(4, -0.25, 0.0);
    let subject = with_bump(5, 0.25, 1.1);
    let found = moved(&prepared(&template), &subject);
    let top =
        |vertices: &[Vec3]| (0..vertices.len()).max_by(|a, b| vertices[*a][2].total_cmp(&vertices[*b][2])).unwrap();
    let before = top(&template.vertices);
    // The highest vertex of the template has moved by 3 along the box, together with the bump.
    let after = found.vertices[before];
    assert!((after[0] - 1.5).abs() < 1.0 && after[1].abs() < 1.0, "{after:?}");
    assert!(found.cover.rms < 0.05 && found.turned == 0, "{:?} {}", found.cover, found.turned);
}

#[test]
fn results_dont_depend_on_the_unit_of_length() {
    let (before, after) = (with_bump(4, 0.0, 0.0), with_bump(3, 0.5, 0.3));
    // Products with a power of two have no rounding errors.
    let larger = |mesh: &Mesh| mesh.with_vertices(mesh.vertices.iter().map(|p| p.map(|x| 1024.0 * x)).collect());
    let found = moved(&prepared(&before), &after);
    let scaled = moved(&prepared(&larger(&before)), &larger(&after));
    let back: Vec<Vec3> = scaled.vertices.iter().map(|p| p.map(|x| x / 1024.0)).collect();
    assert!(root_mean_square(&found.vertices, &back) < 1e-9);
}

#[test]
fn registered_vertices_lie_on_the_subject() {
    let subject = with_bump(5, 0.5, 0.4);
    let found = moved(&prepared(&with_bump(4, 0.0, 0.0)), &subject);
    let tree = spharm_surface::nearest::TriangleTree::new(&subject);
    let farthest = found.vertices.iter().map(|v| tree.nearest(*v).unwrap().distance).fold(0.0, f64::max);
    assert!(farthest < 1e-9, "{farthest}");
}

#[test]
fn a_subject_inside_out_is_the_same_subject() {
    let template = prepared(&with_bump(3, 0.0, 0.0));
    let subject = with_bump(4, 0.2, 0.4);
    let mut inside_out = subject.clone();
    inside_out.faces.iter_mut().for_each(|face| face.swap(1, 2));
    let (one, other) = (moved(&template, &subject), moved(&template, &inside_out));
    assert!(root_mean_square(&one.vertices, &other.vertices) < 0.3);
    assert_eq!((one.turned, other.turned), (0, 0));
}

/// Half of the subject's box is missing, so half of the template has no counterpart and must be marked.
#[test]
fn places_that_a_subject_lacks_are_marked() {
    let whole = with_bump(4, 0.0, 0.0);
    let half: Vec<[u32; 3]> = with_bump(4, 0.0, 0.0)
        .faces
        .into_iter()
        .filter(|face| face.iter().all(|v| whole.vertices[*v as usize][0] < 3.0))
        .collect();
    let subject = Mesh::new(whole.vertices.clone(), half);
    let found = moved(&prepared(&whole), &subject);
    let missing: Vec<usize> = (0..whole.vertices.len()).filter(|v| whole.vertices[*v][0] > 12.0).collect();
    let there: Vec<usize> = (0..whole.vertices.len()).filter(|v| whole.vertices[*v][0] < -2.0).collect();
    let share = |of: &[usize]| of.iter().filter(|v| found.reached[**v]).count() as f64 / of.len() as f64;
    assert!(share(&missing) < 0.1 && share(&there) > 0.95, "{} {}", share(&missing), share(&there));
}

#[test]
fn masked_vertices_draw_nothing_and_arent_reached() {
    let mesh = with_bump(4, 0.0, 0.0);
    let mut original = mesh.clone();
    // The template was made from a surface with an open end, which was closed by a lid.
    original.faces.retain(|face| face.iter().any(|v| mesh.vertices[*v as usize][0] < 12.0));
    let masked = without_counterpart(&mesh, &original, 0.5);
    assert!(masked.iter().any(|masked| *masked) && masked.iter().filter(|masked| **masked).count() < 400);
    let template = Template::new(&mesh, Some(&masked), &RegisterParams::default(), &Silent).unwrap();
    let found = moved(&template, &original);
    assert!(found.reached.iter().zip(&masked).all(|(reached, masked)| !(*reached && *masked)));
    let kept: Vec<usize> = (0..masked.len()).filter(|v| mesh.vertices[*v][0] < 10.0).collect();
    let off: f64 = kept
        .iter()
        .map(|v| dot(sub(found.vertices[*v], mesh.vertices[*v]), sub(found.vertices[*v], mesh.vertices[*v])))
        .sum();
    assert!((off / kept.len() as f64).sqrt() < 0.3);
}

#[test]
fn the_bits_are_the_same_for_any_number_of_threads() {
    let (template, subject) = (with_bump(3, 0.0, 0.0), with_bump(4, 0.4, 0.4));
    let with_threads = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| moved(&prepared(&template), &subject))
    };
    assert_eq!(with_threads(1), with_threads(3));
}

#[test]
fn what_cant_be_registered_is_refused() {
    let mesh = with_bump(2, 0.0, 0.0);
    let params = RegisterParams::default();
    let refused = |mesh: &Mesh, masked: Option<&[bool]>| Template::new(mesh, masked, &params, &Silent).err().unwrap();
    let flat = mesh.with_vertices(vec![[1.0; 3]; mesh.vertices.len()]);
    assert!(matches!(refused(&flat, None), RegisterError::NoArea { what: "the template" }));
    assert!(matches!(Subject::new(&flat).err(), Some(RegisterError::NoArea { what: "the subject" })));
    let mut broken = mesh.clone();
    broken.faces[3] = [0, 1, 9999];
    assert!(matches!(refused(&broken, None), RegisterError::Triangle { face: 3, .. }));
    assert!(matches!(refused(&mesh, Some(&[true])), RegisterError::Values { found: 1, .. }));
    assert!(matches!(refused(&mesh, Some(&vec![true; mesh.vertices.len()])), RegisterError::AllMasked));
    let mut not_finite = mesh.clone();
    not_finite.vertices[0] = [f64::NAN; 3];
    assert!(matches!(refused(&not_finite, None), RegisterError::NoArea { .. }));
}

#[test]
fn a_landmark_that_guides_is_where_it_is_said_to_be() {
    let template = with_bump(4, 0.0, 0.0);
    let subject = with_bump(5, 0.0, 0.3);
    // The landmark is on the flat bottom. The shape alone doesn't determine the positions of points on the bottom.
    let place = Place::nearest(&template, &[[3.0, 1.0, -6.0]]).unwrap()[0];
    let guide = Guide { place, point: [5.0, -1.0, -6.0] };
    let (prepared, target) = (prepared(&template), Subject::new(&subject).unwrap());
    let found = |guides: &[Guide]| {
        let found = register(&prepared, &target, guides, &RegisterParams::default(), &Silent).unwrap();
        let off = sub(place.of(&found.vertices), guide.point);
        (dot(off, off).sqrt(), found)
    };
    let (alone, _) = found(&[]);
    let (guided, registered) = found(&[guide]);
    assert!(alone > 1.5 && guided < 0.3, "{alone} {guided}");
    assert!(registered.cover.rms < 0.1 && registered.turned == 0, "{:?}", registered.cover);
    let wrong = Guide { point: [f64::NAN, 0.0, 0.0], ..guide };
    let refused = register(&prepared, &target, &[guide, wrong], &RegisterParams::default(), &Silent);
    assert!(matches!(refused, Err(RegisterError::Guide { index: 1, .. })));
}
