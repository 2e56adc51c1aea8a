//! Light that arrives straight from the emitters: the source term of a solve by rays.
//!
//!   H_direct(x) = sum over lamps l of  E_l  integral over A_l of V(x, z) K(x, z) dz
//!
//! Rays that leave a surface at random find a small bright emitter rarely, and what they find is noise. The emitters that
//! are worth it are therefore kept apart as [`Lamp`]s: their form factors are known in closed form, and all that is left to
//! sample is what stands between (direct lighting by next event estimation, Kajiya 1986; here with the unoccluded
//! part taken from the closed form, so that a lamp in full view makes no noise).
//!
//! - [`lamp`]: one flat convex polygon that emits evenly: form factor from a point, points on it
//! - [`lamps`]: which emitters are lamps; their light at many points, one segment each
//! - [`caustics`]: their light by way of glass and of mirrors that are not flat
//! - `mirrors`: lamps seen in flat mirrors; `flat_parts`: patches of one kind merged to polygons
//! - [`patches`]: their light averaged over patches, to an accuracy
//! - [`lights`]: light that no patch emits: suns, points and spots, and [`sky`]; [`lighting`]: the same averaged over patches;
//!   [`mod@irradiance`]: to a tolerance

pub mod caustics;
mod flat_parts;
pub mod irradiance;
pub mod lamp;
pub mod lamps;
pub mod lighting;
pub mod lights;
mod mirrors;
pub mod patches;
pub mod sky;

pub use caustics::Caustics;
pub use irradiance::{Irradiance, coefficients, irradiance};
pub use lamp::Lamp;
pub use lamps::Lamps;
pub use lighting::Lighting;
pub use lights::{Cone, Light, Lights};
pub use sky::Sky;

use crate::scene::Scene;
use crate::visibility::Bvh;

/// Where light starts from, but for what bounces, and what it meets on its way.
#[derive(Clone, Copy)]
pub struct Surroundings<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Its lamps.
    pub lamps: &'a Lamps,
    /// The lights that are no patches of it.
    pub lights: &'a Lights,
    /// All patches.
    pub tree: &'a Bvh,
    /// Those that can stand between others.
    pub blockers: &'a Bvh,
}

/// Independent scrambles of every sample.
pub const SCRAMBLES: usize = 4;
// Halves of them, and what is left without one, have to have a spread.
const _: () = assert!(SCRAMBLES >= 4 && SCRAMBLES.is_multiple_of(2));
