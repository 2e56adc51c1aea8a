//! Pictures of a solution from any viewpoint.
//!
//! - [`camera`]: pinhole camera, pixels to rays
//! - [`view`]: the image of a solution, flat or smooth; [`corners`]: what smooth pictures interpolate between
//! - [`final_gather`]: the image of the light that arrives at every pixel, to a tolerance; [`irradiance_cache`]: where it shares work

pub mod camera;
pub mod corners;
pub mod final_gather;
mod irradiance_cache;
pub(crate) mod sight;
pub mod view;

pub use camera::Camera;
pub use corners::Corners;
pub use final_gather::{GatherOptions, Gathered, gather};
pub use view::{Image, Shading, render};
