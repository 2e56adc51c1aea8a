//! Importance: how much what arrives at each patch, and what each gives off, counts for something read off the solution.
//!
//! What is read is a weighted sum of irradiances, l = sum over i of w_i H_i, with H = F (I - rho F)^-1 E. So
//!
//!   l = sum over j of v_j E_j,    v = F^T (I - rho F^T)^-1 w
//!
//! light that runs backwards from w and is reflected on its way: one solve tells the part of every emitter (Smits, Arvo & Salesin
//! 1992, "An importance-driven radiosity algorithm"). For a scalar l(B) with cotangent g_i = dl/dB_i it gives the derivatives to
//! all emissions and reflectances at once, exact for the discrete system: differentiating (I - rho F) B = E,
//!
//!   dl/dE = lambda = (I - rho F)^-T g = g + F^T (I - rho F^T)^-1 (rho g),    dl/drho = lambda H

use super::{Observer, System, check_vector, out_of_range, propagated};
use crate::assembly::{FormFactors, Transposed};
use crate::error::{Error, Result};

/// v = F^T (I - rho F^T)^-1 w for weights of n x b numbers of any sign, to a relative residual.
///
/// # Errors
/// [`Error::Invalid`] for weights that are not finite, a reflectance out of range, or a system without finite solution; what
/// `observe` returns.
pub fn importance(
    form_factors: &dyn FormFactors,
    reflectance: &[f64],
    bands: usize,
    weights: &[f64],
    tolerance: f64,
    observe: &mut Observer,
) -> Result<Vec<f64>> {
    let n = form_factors.len();
    check_vector("the weight", weights, n, bands)?;
    Error::from_problems(out_of_range("reflectance", reflectance, n, bands, 1.0))?;
    let backwards = Transposed(form_factors);
    let system = System { form_factors: &backwards, emission: &[], reflectance, bands };
    let sources = [weights.to_vec()];
    let arriving = propagated(&system, &sources, tolerance, observe)?.and_then(|mut all| all.pop());
    arriving.ok_or_else(|| Error::Invalid("light never dies in this system: there is no finite solution".to_string()))
}
