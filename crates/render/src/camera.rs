//! Projects points onto a picture with an orthographic camera.

use spharm_surface::geometry::{Vec3, add, bounds, cross, dot, scale, sub, unit};

/// Orientation of the camera, which looks at the surface's centre from a given direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Direction from the centre towards the camera; any length above 0.
    pub from: [f64; 3],
    /// Direction that points up in the picture; not parallel to `from`.
    pub up: [f64; 3],
}

impl View {
    /// View from the left in RAS coordinates (-x), with z up: the lateral view of a left hemisphere.
    pub const LEFT: Self = Self::new([-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]);
    /// View from the right in RAS coordinates (+x), with z up.
    pub const RIGHT: Self = Self::new([1.0, 0.0, 0.0], [0.0, 0.0, 1.0]);
    /// View from the front in RAS coordinates (+y), with z up.
    pub const FRONT: Self = Self::new([0.0, 1.0, 0.0], [0.0, 0.0, 1.0]);
    /// View from behind in RAS coordinates (-y), with z up.
    pub const BACK: Self = Self::new([0.0, -1.0, 0.0], [0.0, 0.0, 1.0]);
    /// View from below in RAS coordinates (-z), with y up.
    pub const BOTTOM: Self = Self::new([0.0, 0.0, -1.0], [0.0, 1.0, 0.0]);
    /// View from above in RAS coordinates (+z), with y up.
    pub const TOP: Self = Self::new([0.0, 0.0, 1.0], [0.0, 1.0, 0.0]);
    /// View from the left, the front and above, with z up.
    pub const CORNER: Self = Self::new([-1.0, 0.6, 0.5], [0.0, 0.0, 1.0]);

    /// Returns a view from a direction, with the given up direction.
    #[must_use]
    pub const fn new(from: [f64; 3], up: [f64; 3]) -> Self {
        Self { from, up }
    }
}

/// Maps points in space to pixels, with x to the right and y down, and to a depth that grows towards the camera.
#[derive(Clone, Copy)]
pub(crate) struct Camera {
    right: Vec3,
    up: Vec3,
    pub(crate) towards: Vec3,
    /// Centre of the view in the picture's axes (right, up, towards the camera).
    centre: Vec3,
    /// Number of pixels per unit of length.
    pub(crate) zoom: f64,
    middle: (f64, f64),
}

impl Camera {
    /// Returns a camera whose frame of `width` by `height` pixels contains all points, with a margin.
    pub(crate) fn framing<'a>(
        view: View,
        points: impl IntoIterator<Item = &'a Vec3>,
        width: usize,
        height: usize,
    ) -> Self {
        let towards = unit(view.from);
        let right = unit(cross(view.up, towards));
        let up = cross(towards, right);
        let (low, high) = bounds(points.into_iter().map(|&p| [dot(p, right), dot(p, up), dot(p, towards)]));
        let (width, height) = (width as f64, height as f64);
        let zoom = 0.92 * (width / (high[0] - low[0])).min(height / (high[1] - low[1]));
        let centre = scale(add(low, high), 0.5);
        Self {
            right,
            up,
            towards,
            centre,
            // For fewer than two points, the zoom is arbitrary.
            zoom: if zoom.is_finite() { zoom } else { 1.0 },
            middle: (width / 2.0, height / 2.0),
        }
    }

    /// Returns the position (x, y) of a point in pixels, and its depth.
    pub(crate) fn project(&self, point: Vec3) -> Vec3 {
        let p = [dot(point, self.right), dot(point, self.up), dot(point, self.towards)];
        let [x, y, depth] = scale(sub(p, self.centre), self.zoom);
        [self.middle.0 + x, self.middle.1 - y, depth]
    }

    /// Converts a direction in the picture's axes (right, up, towards the camera) to a unit vector in space.
    pub(crate) fn direction(&self, [right, up, towards]: Vec3) -> Vec3 {
        unit(add(add(scale(self.right, right), scale(self.up, up)), scale(self.towards, towards)))
    }
}
