//! Evaluates the integrands F(q, r) of the energies, with their first and second derivatives. `energy.rs` defines q and
//! r.

/// An integrand F. The function `at` returns F and its partial derivatives: F, F_q, F_r, F_qq, F_qr, F_rr.
pub(crate) trait Density: Copy {
    fn at(self, q: f64, r: f64) -> [f64; 6];
}

/// The integrand F(q, r) = a (r + 1/r) / 2 + b q / r + c (q / r)^3 with a = `area`, b = `shape` and c = `bound`.
#[derive(Clone, Copy)]
pub(crate) struct Balanced {
    pub(crate) area: f64,
    pub(crate) shape: f64,
    pub(crate) bound: f64,
}

impl Density for Balanced {
    #[inline(always)]
    fn at(self, q: f64, r: f64) -> [f64; 6] {
        let s = 1.0 / r;
        // First and second derivatives of the polynomial `shape x + bound x^3` at x = q / r.
        let x = q * s;
        let slope = self.shape + 3.0 * self.bound * x * x;
        let bend = 6.0 * self.bound * x;
        let (ss, xs) = (s * s, x * s);
        [
            0.5 * self.area * (r + s) + self.shape * x + self.bound * x * x * x,
            slope * s,
            0.5 * self.area * (1.0 - ss) - slope * xs,
            bend * ss,
            -ss * (bend * x + slope),
            self.area * ss * s + xs * (bend * xs + 2.0 * slope * s),
        ]
    }
}

/// The integrand F(q, r) = q / r^2 + `shrink` q.
#[derive(Clone, Copy)]
pub(crate) struct Stretch {
    pub(crate) shrink: f64,
}

impl Density for Stretch {
    #[inline(always)]
    fn at(self, q: f64, r: f64) -> [f64; 6] {
        let s = 1.0 / r;
        let ss = s * s;
        [q * ss + self.shrink * q, ss + self.shrink, -2.0 * q * ss * s, 0.0, -2.0 * ss * s, 6.0 * q * ss * ss]
    }
}
