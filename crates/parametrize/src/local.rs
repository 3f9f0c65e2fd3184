//! Computes energy, gradient and positive semidefinite Hessian of one triangle, in closed form.
//!
//! Each corner has two unknowns, its coordinates in the [`frame`] of the tangent plane. Value and gradient are exact on
//! the sphere. The Hessian is computed for the flat triangle between the corners, with negative eigenvalues raised to
//! zero; its relative error is of the order of the triangle's squared size. In complex numbers the linear map between
//! the flat triangles is z -> alpha z + beta conj(z), with
//!
//! ```text
//! q = |alpha|^2 + |beta|^2,   r = |alpha|^2 - |beta|^2,   s1, s2 = |alpha| +- |beta|
//! ```
//!
//! so an energy F(q, r) = G(u, v) depends only on u = |alpha|^2 and v = |beta|^2. Split the changes of alpha and beta
//! into components along alpha and beta, which change the lengths, and across alpha and beta, which change the
//! arguments. The Hessian is then diagonal except for a 2 x 2 block. The entries across alpha and across beta are 2 G_u
//! (twist) and 2 G_v (flip). The block of the components along alpha and beta is
//!
//! ```text
//! | 2 G_u + 4 u G_uu     4 sqrt(u v) G_uv |
//! | 4 sqrt(u v) G_uv     2 G_v + 4 v G_vv |
//! ```
//!
//! This is the eigenanalysis of B. Smith, F. de Goes and T. Kim (ACM Trans. Graph. 38, 2019) without a singular value
//! decomposition. alpha and beta are linear in the corners: alpha = sum of w_j conj(i e_j) / (4 A), beta = sum of w_j i
//! e_j / (4 A), with w_j the corners on the sphere and e_j the edge opposite corner j on the surface.
//!
//! Cost: about 500 flops per triangle. Everything is inlined and free of branches, so that compilers can vectorise
//! loops over triangles.

use crate::angle::atan2_upper;
use crate::density::Density;

/// Number of results per triangle: the energy (1), the gradient (6) and the lower half of the Hessian by rows (21).
pub(crate) const NUMBERS: usize = 28;

/// Number of inputs from which a triangle's derivatives are computed: the coordinates of three corners (9), three
/// cotangents and an area.
pub(crate) const INPUTS: usize = 13;

type Vec3 = [f64; 3];

#[inline(always)]
fn sub(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
fn add(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

#[inline(always)]
fn scale(a: Vec3, s: f64) -> Vec3 {
    [a[0] * s, a[1] * s, a[2] * s]
}

#[inline(always)]
fn dot(a: Vec3, b: Vec3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
fn cross(a: Vec3, b: Vec3) -> Vec3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[inline(always)]
fn positive(x: f64) -> f64 {
    if x > 0.0 { x } else { 0.0 }
}

/// Returns two unit vectors that span the plane perpendicular to p. The vectors depend only on p (T. Duff et al.,
/// "Building an orthonormal basis, revisited", JCGT 6, 2017).
#[inline(always)]
pub(crate) fn frame([x, y, z]: Vec3) -> [Vec3; 2] {
    let sign = if z < 0.0 { -1.0 } else { 1.0 };
    let a = -1.0 / (sign + z);
    let b = x * y * a;
    [[1.0 + sign * x * x * a, sign * b, -sign * x], [b, sign + y * y * a, -y]]
}

/// Quantities of a triangle from which its energy, gradient and Hessian are computed.
struct Triangle {
    ab: Vec3,
    bc: Vec3,
    ca: Vec3,
    volume: f64,
    rest: f64,
    q: f64,
    r: f64,
}

#[inline(always)]
fn triangle([a, b, c]: [Vec3; 3], [x, y, z]: [f64; 3], area: f64) -> Triangle {
    let (ab, bc, ca) = (sub(b, a), sub(c, b), sub(a, c));
    let volume = -dot(a, cross(ab, ca));
    let rest = 1.0 + dot(a, b) + dot(b, c) + dot(c, a);
    let q = (x * dot(bc, bc) + y * dot(ca, ca) + z * dot(ab, ab)) / (4.0 * area);
    // For a flipped triangle r is finite but meaningless; callers use `volume` to reject such triangles.
    let r = 2.0 * atan2_upper(positive(volume), rest) / area;
    Triangle { ab, bc, ca, volume, rest, q, r }
}

/// Returns one triangle's energy; infinite if the triangle is flipped or, up to rounding, flat.
#[inline(always)]
pub(crate) fn value<D: Density>(density: D, p: [Vec3; 3], cotangents: [f64; 3], area: f64) -> f64 {
    let t = triangle(p, cotangents, area);
    let value = area * density.at(t.q, t.r)[0];
    if t.volume > 0.0 { value } else { f64::INFINITY }
}

/// Returns the derivatives of the triangle's linear map z -> alpha z + beta conj(z) with respect to a corner's two
/// unknowns, in four rows: the derivatives of |alpha|, |alpha| times the derivatives of the argument of alpha, and the
/// same two rows for beta.
#[inline(always)]
fn rows(alpha: [f64; 2], beta: [f64; 2], across: [f64; 2], plane: [Vec3; 2], frame: [Vec3; 2]) -> [[f64; 2]; 4] {
    // With `across` = i e / (4 A), where e is the edge opposite the corner on the surface and A is the triangle's area:
    // a = conj(alpha) conj(across), b = conj(beta) across. alpha and beta are scaled to length 1.
    let a = [alpha[0] * across[0] - alpha[1] * across[1], -alpha[0] * across[1] - alpha[1] * across[0]];
    let b = [beta[0] * across[0] + beta[1] * across[1], beta[0] * across[1] - beta[1] * across[0]];
    let [u, w] = frame;
    let [ur, ui] = [dot(u, plane[0]), dot(u, plane[1])];
    let [wr, wi] = [dot(w, plane[0]), dot(w, plane[1])];
    [
        [a[0] * ur - a[1] * ui, a[0] * wr - a[1] * wi],
        [a[0] * ui + a[1] * ur, a[0] * wi + a[1] * wr],
        [b[0] * ur - b[1] * ui, b[0] * wr - b[1] * wi],
        [b[0] * ui + b[1] * ur, b[0] * wi + b[1] * wr],
    ]
}

/// Second derivatives of a triangle's energy with respect to the four numbers that [`rows`] differentiates, multiplied
/// by the triangle's area.
struct Weights {
    /// Entries of the 2 x 2 block of the components along alpha and beta (see the [module](self)): 11, 12 and 22.
    along: [f64; 3],
    twist: f64,
    flip: f64,
}

#[inline(always)]
fn weights([_, fq, fr, fqq, fqr, frr]: [f64; 6], u: f64, v: f64, area: f64) -> Weights {
    let (gu, gv) = (2.0 * (fq + fr), 2.0 * (fq - fr));
    let (guu, guv, gvv) = (fqq + 2.0 * fqr + frr, fqq - frr, fqq - 2.0 * fqr + frr);
    let (m11, m12, m22) = (gu + 4.0 * u * guu, 4.0 * (u * v).sqrt() * guv, gv + 4.0 * v * gvv);
    let (mean, half) = (0.5 * (m11 + m22), 0.5 * (m11 - m22));
    let radius = (half * half + m12 * m12).sqrt();
    let (large, small) = (positive(mean + radius), positive(mean - radius));
    let (mean, share) = (0.5 * area * (large + small), 0.5 * area * (large - small) / (radius + f64::MIN_POSITIVE));
    Weights {
        along: [mean + share * half, share * m12, mean - share * half],
        twist: area * positive(gu),
        flip: area * positive(gv),
    }
}

/// The Hessian in factored form: its coefficients, and the data from which `rows` computes the derivatives at each
/// corner.
struct Flat {
    weights: Weights,
    /// alpha and beta, scaled to length 1.
    alpha: [f64; 2],
    beta: [f64; 2],
    /// For each corner, i e / (4 A), with e the opposite edge on the surface as a complex number, and A the triangle's
    /// area.
    across: [[f64; 2]; 3],
    /// Two unit vectors that span the plane of the triangle on the sphere.
    plane: [Vec3; 2],
}

#[inline(always)]
fn flat(t: &Triangle, densities: [f64; 6], [_, y, z]: [f64; 3], area: f64) -> Flat {
    // Coordinates of the flat triangle on the sphere, with corner b at 0 and c on the real axis.
    let length = dot(t.bc, t.bc).sqrt();
    let normal = cross(t.ca, t.ab);
    let first = scale(t.bc, 1.0 / length);
    let second = cross(scale(normal, 1.0 / dot(normal, normal).sqrt()), first);
    let wa = [-dot(t.ab, first), -dot(t.ab, second)];
    // Coordinates of the corresponding triangle on the surface, likewise with corner b at 0 and corner c on the real
    // axis.
    let long = (2.0 * area * (y + z)).sqrt();
    let (side, height) = (long / (4.0 * area), 0.5 / long);
    let across = [[0.0, side], [-height, -height * z], [height, -height * y]];
    let alpha = [wa[1] * side + length * across[2][0], -wa[0] * side - length * across[2][1]];
    let beta = [-wa[1] * side + length * across[2][0], wa[0] * side + length * across[2][1]];
    let u = alpha[0] * alpha[0] + alpha[1] * alpha[1];
    let v = beta[0] * beta[0] + beta[1] * beta[1];
    let weights = weights(densities, u, v, area);
    let (by_alpha, by_beta) = (1.0 / u.sqrt(), 1.0 / (v + f64::MIN_POSITIVE).sqrt());
    // If beta vanishes, its direction is arbitrary.
    let is_similar = v < 1e-30 * u;
    let beta = [if is_similar { 1.0 } else { beta[0] * by_beta }, if is_similar { 0.0 } else { beta[1] * by_beta }];
    Flat { weights, alpha: [alpha[0] * by_alpha, alpha[1] * by_alpha], beta, across, plane: [first, second] }
}

/// Returns the gradient in space of a triangle's energy with respect to its corner a; `b` and `c` are the other
/// corners.
#[inline(always)]
fn gradient(half: f64, w: f64, [b, c]: [Vec3; 2], bc: Vec3, lengths: Vec3, t: &Triangle) -> Vec3 {
    // With A the area on the surface, and y and z the cotangents at b and c, A dq/da = (z (a - b) + y (a - c)) / 2.
    // With W = A r the solid angle, tan(W / 2) = volume / rest, hence
    // dW = 2 (rest d(volume) - volume d(rest)) / (volume^2 + rest^2).
    // d(rest)/da = b + c, d(volume)/da = b x c = b x (c - b); the last form keeps the digits of short edges.
    add(scale(lengths, half), scale(sub(scale(cross(b, bc), t.rest), scale(add(b, c), t.volume)), w))
}

/// Returns one triangle's energy, gradient and Hessian. For a flipped triangle the energy is infinite and the
/// derivatives are zero.
#[inline(always)]
pub(crate) fn derivatives<D: Density>(density: D, p: [Vec3; 3], cotangents: [f64; 3], area: f64) -> [f64; NUMBERS] {
    let [a, b, c] = p;
    let [x, y, z] = cotangents;
    let t = triangle(p, cotangents, area);
    let densities = density.at(t.q, t.r);
    let (half, w) = (0.5 * densities[1], 2.0 * densities[2] / (t.volume * t.volume + t.rest * t.rest));
    let slopes = [
        gradient(half, w, [b, c], t.bc, sub(scale(t.ca, y), scale(t.ab, z)), &t),
        gradient(half, w, [c, a], t.ca, sub(scale(t.ab, z), scale(t.bc, x)), &t),
        gradient(half, w, [a, b], t.ab, sub(scale(t.bc, x), scale(t.ca, y)), &t),
    ];
    let flat = flat(&t, densities, cotangents, area);
    let frames = [frame(a), frame(b), frame(c)];
    let rows = [
        rows(flat.alpha, flat.beta, flat.across[0], flat.plane, frames[0]),
        rows(flat.alpha, flat.beta, flat.across[1], flat.plane, frames[1]),
        rows(flat.alpha, flat.beta, flat.across[2], flat.plane, frames[2]),
    ];
    let Weights { along: [aa, ab, bb], twist, flip } = flat.weights;
    let mut numbers = [0.0; NUMBERS];
    let mut at = 7;
    let mut sum = 0.0;
    for i in 0..6 {
        let [ra, ta, rb, tb] =
            [rows[i / 2][0][i % 2], rows[i / 2][1][i % 2], rows[i / 2][2][i % 2], rows[i / 2][3][i % 2]];
        let weighted = [aa * ra + ab * rb, twist * ta, ab * ra + bb * rb, flip * tb];
        numbers[1 + i] = dot(slopes[i / 2], frames[i / 2][i % 2]);
        for j in 0..=i {
            let [k, l] = [j / 2, j % 2];
            let entry = weighted[0] * rows[k][0][l]
                + weighted[1] * rows[k][1][l]
                + weighted[2] * rows[k][2][l]
                + weighted[3] * rows[k][3][l];
            numbers[at] = entry;
            at += 1;
        }
        sum += numbers[at - 1] + numbers[1 + i];
    }
    numbers[0] = area * densities[0];
    let is_sound = t.volume > 0.0 && sum.abs() < f64::INFINITY;
    for number in &mut numbers[1..] {
        *number = if is_sound { *number } else { 0.0 };
    }
    numbers[0] = if t.volume > 0.0 { numbers[0] } else { f64::INFINITY };
    numbers
}

/// Returns one triangle's energy, and its gradient and Hessian (entries 00, 10 and 11) with respect to the two unknowns
/// of the first corner. For a flipped triangle the energy is infinite and the derivatives are zero.
#[inline(always)]
pub(crate) fn corner_derivatives<D: Density>(
    density: D,
    p: [Vec3; 3],
    cotangents: [f64; 3],
    area: f64,
    frame: [Vec3; 2],
) -> [f64; 6] {
    let [_, b, c] = p;
    let [_, y, z] = cotangents;
    let t = triangle(p, cotangents, area);
    let densities = density.at(t.q, t.r);
    let (half, w) = (0.5 * densities[1], 2.0 * densities[2] / (t.volume * t.volume + t.rest * t.rest));
    let slope = gradient(half, w, [b, c], t.bc, sub(scale(t.ca, y), scale(t.ab, z)), &t);
    let flat = flat(&t, densities, cotangents, area);
    let [ra, ta, rb, tb] = rows(flat.alpha, flat.beta, flat.across[0], flat.plane, frame);
    let Weights { along: [aa, ab, bb], twist, flip } = flat.weights;
    let mut numbers = [area * densities[0], dot(slope, frame[0]), dot(slope, frame[1]), 0.0, 0.0, 0.0];
    let mut sum = 0.0;
    for (at, [i, j]) in [(3, [0, 0]), (4, [1, 0]), (5, [1, 1])] {
        numbers[at] = (aa * ra[i] + ab * rb[i]) * ra[j]
            + twist * ta[i] * ta[j]
            + (ab * ra[i] + bb * rb[i]) * rb[j]
            + flip * tb[i] * tb[j];
        sum += numbers[at] + numbers[at - 2];
    }
    let is_sound = t.volume > 0.0 && sum.abs() < f64::INFINITY;
    for number in &mut numbers[1..] {
        *number = if is_sound { *number } else { 0.0 };
    }
    numbers[0] = if t.volume > 0.0 { numbers[0] } else { f64::INFINITY };
    numbers
}

#[cfg(test)]
mod tests;
