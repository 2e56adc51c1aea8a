//! Diffuse light and heat between the surfaces of a 3-D scene.
//!
//! The radiosity equation (Goral, Torrance, Greenberg & Battaile 1984), for patches i, j of a scene, per band:
//!
//!   B_i = E_i + rho_i H_i,    H_i = sum over j of F_ij B_j
//!
//! | quantity | symbol | unit |
//! |---|---|---|
//! | radiosity: all that leaves, per area | B | W/m^2 |
//! | emission: self-emitted radiosity | E | W/m^2 |
//! | reflectance | rho | 1, in [0, 1] |
//! | irradiance: all that arrives, per area | H | W/m^2 |
//! | form factor: the fraction of what leaves i that reaches j | F_ij | 1; row i emits |
//! | symmetric exchange | G_ij = A_i F_ij = G_ji | m^2 |
//! | unshot radiosity: the residual E + rho F B - B | r | W/m^2 |
//! | radiance of a diffuse surface | L = B / pi | W/(m^2 sr) |
//!
//! Map of the house; each module may use those above it, never those below:
//!
//! - [`geometry`]: polygons, quadrature, quasi-random points, subdivision
//! - [`scene`]: patches and their materials, validated
//! - [`visibility`]: does x see y?
//! - [`form_factor`]: F of one pair, to a tolerance
//! - [`direct`]: light straight from the emitters
//! - [`assembly`]: F of a scene as an operator
//! - [`solve`]: matrix inversion, Jacobi, Gauss-Seidel, Southwell, GMRES
//! - [`hierarchy`]: F as links between elements of all sizes
//! - [`accuracy`]: a scene solved to a tolerance of the true error
//! - [`render`]: pictures of a solution
//! - [`instant`]: pictures without a solution, from virtual point lights (Keller 1997)
//!
//! [`error`], [`memory`], [`progress`] and [`simd`] serve all of them. The core knows no Python, prints nothing, reads no files.
//!
//! References: M. F. Cohen & J. R. Wallace, "Radiosity and Realistic Image Synthesis", 1993; F. X. Sillion & C. Puech,
//! "Radiosity and Global Illumination", 1994.

pub mod accuracy;
pub mod assembly;
pub mod direct;
pub mod error;
pub mod form_factor;
pub mod geometry;
pub mod hierarchy;
pub mod instant;
pub mod memory;
pub mod progress;
pub mod render;
pub mod scene;
mod simd;
pub mod solve;
pub mod visibility;

#[cfg(feature = "python")]
mod python;

pub use error::{Error, Result};
pub use progress::Progress;
