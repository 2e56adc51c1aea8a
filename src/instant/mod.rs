//! Instant radiosity: a picture as the sum of pictures of few lights (Keller, "Instant radiosity", SIGGRAPH 1997).
//!
//! Particles that leave the lamps and bounce between the surfaces leave a virtual point light of flux Phi_k, W,
//! wherever they are reflected. What a point x of reflectance rho sends to the eye is then
//!
//!   L(x) = (E + rho H) / pi,    H(x) = sum over k of Phi_k / pi G(x, y_k) V(x, y_k),    G = cos_x cos_y / r^2
//!
//! without patches, form factors or a system to solve. Near a light G has no bound, though it may be summed over (the
//! weak singularity): so every light shines with min(G, c), and what that cuts is found by short rays (Kollig &
//! Keller, "Illumination in the presence of weak singularities", 2004), with y where a ray of density cos / pi from x
//! ends:
//!
//!   H(x) = sum over k of Phi_k / pi min(G, c) V  +  mean over rays of max(0, 1 - c / G(x, y)) pi L(y)
//!
//! L(y) is found in the same way: where G > c, which is nearer than 1 / sqrt(c), the path goes on.
//!
//! - [`halton`]: the scrambled sequence that particles follow
//! - [`walk`]: where they leave lights
//! - [`mod@gather`]: the picture, with shadows by segments; or only what pictures with shadows from elsewhere lack

pub mod gather;
mod halton;
pub mod walk;

pub use gather::{InstantOptions, Picture, SAMPLES, bounds, default_bound, gather, places, sample_of};
pub use walk::{Lights, virtual_lights};
