//! Tests of the pictures' contents.

use spharm_render::{Image, Paint, Panel, RenderError, Settings, View, render, write_png, write_thumbnail};
use spharm_surface::Mesh;
use spharm_surface::generate::icosphere;
use spharm_surface::io::WriteOptions;

fn small() -> Settings {
    Settings { width: 100, height: 100, view: View::FRONT, ..Settings::default() }
}

fn at(image: &Image, x: usize, y: usize) -> [u8; 3] {
    image.pixels[y * image.width + x]
}

/// Returns the fraction of pixels that aren't background.
fn covered(image: &Image) -> f64 {
    let ink = image.pixels.iter().filter(|&&p| p != [255; 3]).count();
    ink as f64 / image.pixels.len() as f64
}

#[test]
fn a_ball_covers_a_disc() {
    let ball = icosphere(4);
    let image = render(&[Panel::new(&ball, "")], &small()).unwrap();
    // The ball's diameter is 92 of the picture's 100 pixels.
    let disc = std::f64::consts::PI * 0.46 * 0.46;
    assert!((covered(&image) - disc).abs() < 0.02, "{}", covered(&image));
    assert_eq!(at(&image, 1, 1), [255; 3]);
    // The ball is lit from the upper left.
    let brightness = |p: [u8; 3]| p.iter().map(|&c| u32::from(c)).sum::<u32>();
    assert!(brightness(at(&image, 32, 28)) > brightness(at(&image, 68, 75)) + 60);
}

#[test]
fn a_thumbnail_has_few_colours_near_those_of_the_picture() {
    let ball = icosphere(4);
    let height: Vec<[u8; 3]> = ball.vertices.iter().map(|v| [(127.0 + 120.0 * v[2]) as u8, 150, 90]).collect();
    let panel = Panel { paint: Paint::Vertices(&height), ..Panel::new(&ball, "") };
    let image = render(&[panel], &small()).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let [plain, thumbnail] = ["plain.png", "thumbnail.png"].map(|name| folder.path().join(name));
    write_png(&plain, &image, &WriteOptions::default()).unwrap();
    write_thumbnail(&thumbnail, &image, &WriteOptions::default()).unwrap();
    assert!(write_thumbnail(&thumbnail, &image, &WriteOptions::default()).is_err(), "the file exists");
    let bytes = |path: &std::path::Path| std::fs::metadata(path).unwrap().len();
    assert!(2 * bytes(&thumbnail) < bytes(&plain), "{} of {}", bytes(&thumbnail), bytes(&plain));
    let mut decoder = png::Decoder::new(std::io::BufReader::new(std::fs::File::open(&thumbnail).unwrap()));
    decoder.set_transformations(png::Transformations::EXPAND);
    let mut reader = decoder.read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    reader.next_frame(&mut pixels).unwrap();
    let (pixels, _) = pixels.as_chunks::<3>();
    let colours: std::collections::HashSet<&[u8; 3]> = pixels.iter().collect();
    assert!(colours.len() <= 64, "{}", colours.len());
    let far = |(a, b): (&[u8; 3], &[u8; 3])| a.iter().zip(b).map(|(a, b)| a.abs_diff(*b)).max().unwrap();
    let mean = pixels.iter().zip(&image.pixels).map(|pair| f64::from(far(pair))).sum::<f64>() / pixels.len() as f64;
    assert!(mean < 4.0, "{mean}");
    // A frame twice as large as the ball shows the ball at half the size.
    let frame = Some([[-2.0; 3], [2.0; 3]]);
    let half = render(&[Panel::new(&ball, "")], &Settings { frame, ..small() }).unwrap();
    assert!((covered(&half) / covered(&image) - 0.25).abs() < 0.02, "{}", covered(&half));
}

#[test]
fn what_is_nearer_hides_what_is_farther_in_any_order() {
    // Two squares across the line of sight (y); the nearer square is smaller.
    let square = |y: f64, half: f64| [[-half, y, -half], [half, y, -half], [half, y, half], [-half, y, half]];
    let vertices = [square(0.0, 2.0), square(1.0, 1.0)].concat();
    let (far, near) = ([[0, 1, 2], [0, 2, 3]], [[4, 5, 6], [4, 6, 7]]);
    let values = [0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0];
    let paint = Paint::Scalar { values: &values, range: (0.0, 1.0), label: "" };
    for faces in [[far, near].concat(), [near, far].concat()] {
        let mesh = Mesh::new(vertices.clone(), faces);
        let image = render(&[Panel { paint, ..Panel::new(&mesh, "") }], &small()).unwrap();
        let yellow = |p: [u8; 3]| p[0] / 2 > p[2];
        let middle = (0..100).rev().find(|&y| yellow(at(&image, 50, y)) && y < 70);
        assert!(middle.is_some(), "the near square shows");
        assert!(!yellow(at(&image, 28, 12)), "the far one shows around it");
    }
}

#[test]
fn panels_fill_a_grid_with_captions_beneath() {
    let ball = icosphere(2);
    let panels = [Panel::new(&ball, "one"), Panel::new(&ball, ""), Panel::new(&ball, "three")];
    let image = render(&panels, &Settings { columns: 2, ..small() }).unwrap();
    assert_eq!((image.width, image.height), (200, 200));
    let ink = |x: std::ops::Range<usize>, y: std::ops::Range<usize>| {
        y.flat_map(|y| x.clone().map(move |x| (x, y))).filter(|&(x, y)| at(&image, x, y) != [255; 3]).count()
    };
    assert!(ink(0..100, 82..100) > 20, "the first caption");
    assert_eq!(ink(100..200, 82..100), 0, "no second caption");
    assert!(ink(0..100, 182..200) > ink(0..100, 82..100), "a longer word takes more ink");
    assert_eq!(ink(100..200, 100..200), 0, "no fourth panel");
}

#[test]
fn pictures_are_stored_as_png() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.png");
    let ball = icosphere(1);
    let image = render(&[Panel::new(&ball, "a")], &small()).unwrap();
    write_png(&path, &image, &WriteOptions::default()).unwrap();
    let file = std::io::BufReader::new(std::fs::File::open(&path).unwrap());
    let mut reader = png::Decoder::new(file).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    assert_eq!((info.width, info.height), (100, 100));
    assert_eq!(pixels, image.pixels.as_flattened());
}

#[test]
fn senseless_requests_are_told() {
    let ball = icosphere(0);
    assert!(render(&[], &small()).is_err());
    assert!(render(&[Panel::new(&ball, "")], &Settings { width: 0, ..small() }).is_err());
    assert!(render(&[Panel::new(&ball, "")], &Settings { height: usize::MAX, ..small() }).is_err());
    let paint = Paint::Scalar { values: &[1.0], range: (0.0, 1.0), label: "" };
    let error = render(&[Panel { paint, ..Panel::new(&ball, "") }], &small()).unwrap_err();
    assert!(matches!(error, RenderError::ValueCount { expected: 12, found: 1 }), "{error}");
    // Triangles with vertices that aren't finite aren't drawn.
    let mut broken = ball.clone();
    broken.vertices[3] = [f64::NAN; 3];
    render(&[Panel::new(&broken, "")], &small()).unwrap();
}

/// Values of both signs are blue and red with grey at 0, and each panel may have a view of its own.
#[test]
fn signed_values_are_blue_and_red_and_panels_have_their_own_views() {
    let ball = icosphere(3);
    let values: Vec<f64> = ball.vertices.iter().map(|p| p[0]).collect();
    let panel = |range, view| {
        let paint = Paint::Scalar { values: &values, range, label: "" };
        Panel { paint, view: Some(view), ..Panel::new(&ball, "") }
    };
    let centre = |range, view| {
        let image = render(&[panel(range, view)], &small()).expect("a picture");
        at(&image, image.width / 2, image.height / 3)
    };
    // The ball is seen from the side where x is least or greatest.
    let ([red, _, blue], [more_red, _, less_blue]) =
        (centre((-1.0, 1.0), View::LEFT), centre((-1.0, 1.0), View::RIGHT));
    assert!(blue > red && more_red > less_blue, "{blue} {red}, {more_red} {less_blue}");
    let [red, green, blue] = centre((-1.0, 1.0), View::FRONT);
    assert!(red.abs_diff(blue) < 30 && red.abs_diff(green) < 30, "{red} {green} {blue}");
    // A range of one sign keeps the colours from dark blue to yellow.
    let [red, green, blue] = centre((-1.0, 0.5), View::RIGHT);
    assert!(red > blue && green > blue, "{red} {green} {blue}");
}
