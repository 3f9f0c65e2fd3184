//! Tests the contents of pictures.

use spharm_render::{
    Contour, Image, Paint, Panel, RenderError, Settings, View, render, with_note, write_png, write_svg, write_thumbnail,
};
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

/// Returns a pixel of the middle row, at a place between the left end of what is drawn, 0, and the right end, 1.
fn across(image: &Image, place: f64) -> [u8; 3] {
    let row = &image.pixels[image.height / 2 * image.width..][..image.width];
    let drawn = |pixel: &[u8; 3]| *pixel != [255; 3];
    let (first, last) = (row.iter().position(drawn).unwrap(), row.iter().rposition(drawn).unwrap());
    row[(first as f64 + place * (last - first) as f64).round() as usize]
}

#[test]
fn shading_follows_the_direction_of_normals_and_not_their_area() {
    // A gable roof: half way up a side, the normal is half way between the side's, tilted by 80 degrees, and the
    // ridge's, which is vertical. Around a vertex of the ridge, the sum of the normals weighted by area is a third as
    // long as around one of the eaves.
    const ROWS: u32 = 40;
    let slope = 80_f64.to_radians();
    let vertices = (0..=ROWS).flat_map(|row| {
        let y = f64::from(row) / 20.0 - 1.0;
        [-1.0, 0.0, 1.0].map(|x: f64| [x, y, -x.abs() * slope.tan()])
    });
    let faces = (0..ROWS).flat_map(|row| [3 * row, 3 * row + 1]).flat_map(|v| [[v, v + 1, v + 4], [v, v + 4, v + 3]]);
    let roof = Mesh::new(vertices.collect(), faces.collect());
    let settings = Settings { width: 400, height: 400, view: View::TOP, ..Settings::default() };
    let [roof, ball] = [roof, icosphere(5)].map(|mesh| render(&[Panel::new(&mesh, "")], &settings).unwrap());
    let left = across(&roof, 0.25);
    let same_normal_on_the_ball = across(&ball, 0.5 - 0.5 * (slope / 2.0).sin());
    for (found, expected) in left.iter().zip(same_normal_on_the_ball) {
        assert!(found.abs_diff(expected) <= 4, "{left:?}, on a ball {same_normal_on_the_ball:?}");
    }
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
    // In a frame twice as large as the ball, the ball has half the size.
    let frame = Some([[-2.0; 3], [2.0; 3]]);
    let half = render(&[Panel::new(&ball, "")], &Settings { frame, ..small() }).unwrap();
    assert!((covered(&half) / covered(&image) - 0.25).abs() < 0.02, "{}", covered(&half));
}

#[test]
fn what_is_nearer_hides_what_is_farther_in_any_order() {
    // The mesh has two squares perpendicular to the line of sight (y), of which the nearer one is smaller.
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

/// Seen from the side, the contour z = 0.5 on the unit ball is a horizontal line half way between the centre and the
/// top.
#[test]
fn contours_are_where_the_map_has_the_level() {
    let ball = icosphere(5);
    let mut values: Vec<f64> = ball.vertices.iter().map(|v| 10.0 * v[2]).collect();
    let draw = |values: &[f64], level: f64| {
        let frame = Some([[-1.25; 3], [1.25; 3]]);
        let contour = Some(Contour { values, level });
        render(&[Panel { contour, ..Panel::new(&ball, "") }], &Settings { frame, ..small() }).unwrap()
    };
    let plain =
        render(&[Panel::new(&ball, "")], &Settings { frame: Some([[-1.25; 3], [1.25; 3]]), ..small() }).unwrap();
    // Returns the rows in which a column of pixels is darker than without the contour.
    let dark = |image: &Image, x: usize| {
        let sum = |image: &Image, y: usize| at(image, x, y).iter().map(|&c| u32::from(c)).sum::<u32>();
        (0..100).filter(|&y| sum(image, y) + 60 < sum(&plain, y)).collect::<Vec<_>>()
    };
    let (top, middle) = (draw(&values, 5.0), draw(&values, 0.0));
    let covered = (0..100).filter(|&y| at(&plain, 50, y) != [255; 3]).count() as f64;
    for x in [35, 50, 65] {
        let (upper, lower) = (dark(&top, x), dark(&middle, x));
        assert!((1..=2).contains(&upper.len()) && (1..=2).contains(&lower.len()), "{x}: {upper:?} {lower:?}");
        let distance = lower[0] as f64 - upper[0] as f64;
        assert!((distance - covered / 4.0).abs() <= 2.0, "{x}: {distance} of {covered}");
    }
    assert!(draw(&values, 11.0) == plain, "no line for a level beyond the map");
    values.iter_mut().for_each(|value| *value = f64::NAN);
    assert!(draw(&values, 5.0) == plain, "no line without values");
    let short = [1.0];
    let contour = Some(Contour { values: &short, level: 0.0 });
    assert!(render(&[Panel { contour, ..Panel::new(&ball, "") }], &small()).is_err());
}

#[test]
fn text_stays_text_in_svg_and_resolutions_are_stored() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let ball = icosphere(1);
    let values = vec![0.5; ball.vertices.len()];
    let paint = Paint::Scalar { values: &values, range: (0.0, 2.5), label: "a < b & c" };
    let settings = Settings { keep_text: true, dpi: Some(72), ..small() };
    let image = with_note(render(&[Panel { paint, ..Panel::new(&ball, "ball") }], &settings).unwrap(), "a note");
    write_svg(path("a.svg"), &image, &WriteOptions::default()).unwrap();
    let svg = std::fs::read_to_string(path("a.svg")).unwrap();
    assert!(svg.contains("width=\"35.278mm\"") && svg.contains("href=\"data:image/png;base64,"), "{svg}");
    for (anchor, text) in [("end", "0"), ("start", "2.5"), ("middle", "a &lt; b &amp; c"), ("middle", "ball")] {
        let line = svg.lines().find(|line| line.ends_with(&format!(">{text}</text>")));
        assert!(line.is_some_and(|line| line.contains(&format!("text-anchor=\"{anchor}\""))), "{text}: {svg}");
    }
    assert!(svg.contains(">a note</text>"));
    // The picture is blank at the position of the caption, which is stored as text.
    let caption = (0..100).flat_map(|x| (84..100).map(move |y| (x, y)));
    assert!(caption.clone().all(|(x, y)| at(&image, x, y) == [255; 3]));

    write_png(path("a.png"), &image, &WriteOptions::default()).unwrap();
    let reader = png::Decoder::new(std::io::BufReader::new(std::fs::File::open(path("a.png")).unwrap()));
    let found = reader.read_info().unwrap().info().pixel_dims.unwrap();
    assert_eq!((found.xppu, found.yppu, found.unit), (2835, 2835, png::Unit::Meter));
    assert!(write_svg(path("b.png"), &image, &WriteOptions::default()).is_err());
}

#[test]
fn text_is_legible_on_paper_and_stays_in_its_panel() {
    // Height of 7 pt at 300 dpi, in pixels.
    const LEAST: f64 = 7.0 / 72.0 * 300.0;
    let folder = tempfile::tempdir().unwrap();
    let ball = icosphere(2);
    let values = vec![0.5; ball.vertices.len()];
    let label = "statistic, 102 of 10242 values clipped";
    let paint = Paint::Scalar { values: &values, range: (-3.96, 3.96), label };
    let panels = [Panel { paint, ..Panel::new(&ball, "the first caption, from -x") }, Panel::new(&ball, "second")];
    for width in [96, 354, 530] {
        let settings = Settings { width, height: width, dpi: Some(300), ..Settings::default() };
        let image = render(&panels, &settings).unwrap();
        assert!(settings.bytes(2, ball.vertices.len()) >= 6 * image.pixels.len() as u64, "{width}");
        for x in [0, width - 1, width, 2 * width - 1] {
            assert!((0..image.height).all(|y| at(&image, x, y) == [255; 3]), "{width}: text in column {x}");
        }
        let kept = render(&panels, &Settings { keep_text: true, ..settings }).unwrap();
        let path = folder.path().join(format!("{width}.svg"));
        write_svg(&path, &with_note(kept, "line: p = 0.05"), &WriteOptions::default()).unwrap();
        let svg = std::fs::read_to_string(&path).unwrap();
        let value = |line: &str, key: &str| -> f64 {
            let rest = line.split(&format!(" {key}=\"")).nth(1).unwrap();
            rest.split('"').next().unwrap().parse().unwrap()
        };
        let texts: Vec<&str> = svg.lines().filter(|line| line.starts_with("<text")).collect();
        assert!(texts.len() >= 4 && texts.iter().all(|line| value(line, "font-size") >= LEAST), "{width}: {texts:?}");
        let centred = texts.iter().filter(|line| line.contains("\"middle\""));
        let mut places: Vec<[f64; 2]> = centred.map(|line| [value(line, "x"), value(line, "y")]).collect();
        places.sort_unstable_by(|a, b| a.partial_cmp(b).unwrap());
        let apart = |pair: &[[f64; 2]]| pair[0][0] < pair[1][0] || pair[1][1] - pair[0][1] >= LEAST;
        assert!(places.windows(2).all(apart), "{width}: lines overlap: {texts:?}");
    }
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
    // Triangles with a vertex that isn't finite aren't drawn.
    let mut broken = ball.clone();
    broken.vertices[3] = [f64::NAN; 3];
    render(&[Panel::new(&broken, "")], &small()).unwrap();
}

/// In a symmetric range, negative values are blue, positive values red and values near 0 grey. Each panel may have a
/// different view.
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
    // The ball is seen from the side with the smallest x, and from the side with the largest x.
    let ([red, _, blue], [more_red, _, less_blue]) =
        (centre((-1.0, 1.0), View::LEFT), centre((-1.0, 1.0), View::RIGHT));
    assert!(blue > red && more_red > less_blue, "{blue} {red}, {more_red} {less_blue}");
    let [red, green, blue] = centre((-1.0, 1.0), View::FRONT);
    assert!(red.abs_diff(blue) < 30 && red.abs_diff(green) < 30, "{red} {green} {blue}");
    // A range that isn't symmetric about 0 has colours from dark blue to yellow.
    let [red, green, blue] = centre((-1.0, 0.5), View::RIGHT);
    assert!(red > blue && green > blue, "{red} {green} {blue}");
}

#[test]
fn all_views_of_a_picture_have_one_scale() {
    let mut body = icosphere(4);
    body.vertices.iter_mut().for_each(|v| *v = [v[0], 3.0 * v[1], 0.5 * v[2]]);
    let views = [View::LEFT, View::TOP, View::FRONT];
    let panels = views.map(|view| Panel { view: Some(view), ..Panel::new(&body, "") });
    let size = |image: &Image, panel: usize| {
        let ink = (0..image.height).flat_map(|y| (0..100).map(move |x| (x, y)));
        let ink: Vec<_> = ink.filter(|&(x, y)| at(image, 100 * panel + x, y) != [255; 3]).collect();
        let extent = |of: fn(&(usize, usize)) -> usize| {
            let values = ink.iter().map(of);
            (values.clone().max().unwrap() - values.min().unwrap() + 1) as f64
        };
        [extent(|at| at.0), extent(|at| at.1)]
    };
    let wide = Some([[-1.5, -4.5, -0.75], [1.5, 4.5, 0.75]]);
    for (frame, pixels) in [(None, 46.0), (wide, 46.0 / 1.5)] {
        let image = render(&panels, &Settings { frame, ..small() }).unwrap();
        // The longest axis fills the panel, and the others are in proportion: x is a third of y, z a sixth.
        let [x, y, z] = [1.0, 3.0, 0.5].map(|half| 2.0 * half * pixels / 3.0);
        for (panel, expected) in [[y, z], [x, y], [x, z]].into_iter().enumerate() {
            let found = size(&image, panel);
            let close = (0..2).all(|axis| (found[axis] - expected[axis]).abs() < 3.0);
            assert!(close, "panel {panel}: {found:?} pixels, expected {expected:?}");
        }
    }
}
