//! Generates closed surfaces of genus zero, determined by a seed.

use spharm_surface::Mesh;
use spharm_surface::generate::icosphere;

/// A sequence of numbers in [-1, 1): the finaliser of SplitMix64, applied to a counter.
pub(crate) struct Draws(pub(crate) u64);

impl Draws {
    pub(crate) fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut x = self.0;
        x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((x ^ (x >> 31)) >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    fn direction(&mut self) -> [f64; 3] {
        loop {
            let v = [self.next(), self.next(), self.next()];
            let length = dot(v, v).sqrt();
            if length > 0.1 && length < 1.0 {
                return v.map(|x| x / length);
            }
        }
    }
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn moved(sphere: &Mesh, f: impl FnMut(&[f64; 3]) -> [f64; 3]) -> Mesh {
    sphere.with_vertices(sphere.vertices.iter().map(f).collect())
}

/// The kinds of surface, in the order in which seeds cycle through them.
const KINDS: [&str; 5] = ["blob", "spikes", "thin shell", "arms", "noise"];

/// Returns the surface with a given seed, and its kind. Of every 20 seeds, the last 5 give meshes four times as fine.
pub(crate) fn surface(seed: u64) -> (&'static str, Mesh) {
    let fine = seed / 5 % 4 == 3;
    let mut draws = Draws(seed.wrapping_mul(1000));
    let sphere = icosphere(2 + u32::from(fine));
    let kind = KINDS[(seed % 5) as usize];
    let mesh = match kind {
        "blob" => {
            let waves: Vec<([f64; 3], f64)> = (0..8).map(|_| (draws.direction(), draws.next())).collect();
            moved(&sphere, |&p| {
                let sum: f64 = waves.iter().map(|(d, phase)| (5.0 * dot(*d, p) + 3.0 * phase).sin()).sum();
                p.map(|x| x * (0.15 * sum).exp())
            })
        }
        "spikes" => {
            let chosen: Vec<bool> = sphere.vertices.iter().map(|_| draws.next() > 0.9).collect();
            let mut at = 0;
            moved(&sphere, |&p| {
                at += 1;
                if chosen[at - 1] { p.map(|x| x * 8.0) } else { p }
            })
        }
        "thin shell" => {
            // A sphere pushed into itself: two sheets at distance `thickness`, joined by a rim.
            let thickness = 0.05 * (1.01 + draws.next());
            let open = 1.2 + 0.3 * draws.next();
            moved(&sphere, |&[x, y, z]| {
                let theta = x.hypot(y).atan2(z);
                let half = std::f64::consts::FRAC_PI_2;
                let (angle, radius) = if theta < half {
                    (open * theta / half, 1.0 + thickness)
                } else {
                    (open * (2.0 - theta / half), 1.0)
                };
                let phi = y.atan2(x);
                [radius * angle.sin() * phi.cos(), radius * angle.sin() * phi.sin(), radius * angle.cos()]
            })
        }
        "arms" => {
            let arms: Vec<[f64; 3]> = (0..4).map(|_| draws.direction()).collect();
            moved(&sphere, |&p| {
                let reach: f64 = arms.iter().map(|a| 6.0 * (60.0 * (dot(*a, p) - 1.0)).exp()).sum();
                p.map(|x| x * (1.0 + reach))
            })
        }
        _ => {
            // The noise is as large as the triangles, so they cross and fold in space. The map must be one to one all
            // the same.
            let size = if fine { 0.15 } else { 0.3 };
            moved(&sphere, |&p| p.map(|x| x + size * draws.next()))
        }
    };
    (kind, mesh)
}
