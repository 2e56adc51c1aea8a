//! Pictures of a solution from any viewpoint.
//!
//! - [`camera`]: pinhole camera, pixels to rays
//! - [`view`]: the image of a solution, flat or smooth

pub mod camera;
pub mod view;

pub use camera::Camera;
pub use view::{Image, Shading, render};
