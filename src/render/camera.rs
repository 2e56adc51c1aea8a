//! The pinhole camera.

use crate::error::{Error, Result};
use crate::geometry::Vec3;

/// A pinhole camera; row 0 of its image is on top.
#[derive(Debug, Clone, Copy)]
pub struct Camera {
    origin: Vec3,
    forward: Vec3,
    /// Half the image plane at distance 1, to the right and up, per unit of half height.
    right: Vec3,
    up: Vec3,
    tangent: f64,
}

impl Camera {
    /// A camera at `origin` that looks at `target`, with `fov` degrees from the lower to the upper edge.
    ///
    /// # Errors
    /// [`Error::Invalid`] for coordinates that are not finite, a target at the origin, an up vector along the view, or a
    /// field of view outside (0, 180).
    pub fn new(origin: Vec3, target: Vec3, up: Vec3, fov: f64) -> Result<Camera> {
        let mut problems = Vec::new();
        for (name, v) in [("origin", origin), ("target", target), ("up", up)] {
            if !v.is_finite() {
                problems.push(format!("camera {name} {v} is not finite"));
            }
        }
        if !(fov > 0.0 && fov < 180.0) {
            problems.push(format!("camera fov {fov} is outside (0, 180) degrees"));
        }
        Error::from_problems(problems)?;
        let view = target - origin;
        if view.length() <= 0.0 {
            return Err(Error::Invalid(format!("camera target {target} is the same point as its origin")));
        }
        if !view.length().is_finite() {
            return Err(Error::Invalid(format!("camera target {target} is too far from its origin {origin}")));
        }
        let forward = view.normalize();
        // Its square may overflow where its coordinates do not.
        let upward = up / up.abs().max_element();
        let side = forward.cross(upward);
        // An angle below 1e-9 between up and the view leaves the horizon to rounding.
        if !(side.length() > 1e-9 * upward.length()) {
            return Err(Error::Invalid(format!("camera up {up} is parallel to the view direction {forward}")));
        }
        let right = side.normalize();
        Ok(Camera { origin, forward, right, up: right.cross(forward), tangent: (0.5 * fov.to_radians()).tan() })
    }

    /// The point that all rays start from.
    pub fn origin(&self) -> Vec3 {
        self.origin
    }

    /// The direction, not normalised, through image point (x, y) in pixels from the upper left corner.
    #[inline]
    pub fn direction(&self, x: f64, y: f64, width: usize, height: usize) -> Vec3 {
        let scale = self.tangent / (0.5 * height as f64);
        self.forward + scale * ((x - 0.5 * width as f64) * self.right + (0.5 * height as f64 - y) * self.up)
    }
}
