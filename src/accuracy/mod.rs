//! A scene solved to a tolerance of the true error: ask for 1 %, get 1 %.
//!
//! The error is that of the reflected radiosity B - E, patch averages, against the continuous solution:
//!
//!   (sum over i of A_i dB_i^2  /  sum over i of A_i (B_i - E_i)^2)^(1/2),   the worst band
//!
//! with rho H in place of B - E. Where a band reflects nothing anywhere, H itself takes the place of both.
//!
//! # How
//! Let T be one bounce, (T H)(x) = integral of rho V K H, and H the light that arrives: H = D + u, with D straight from the lamps
//! ([`crate::direct`]) and u = T (D + u) all that has bounced.
//!
//! 1. *Pilot.* A few rays a patch make an operator T0 ([`crate::assembly::rays`]). GMRES with constant patches and one bounce more
//!    make the field u0, linear on every patch.
//! 2. *Base.* Four independent sets of rays, of which nothing is kept but sums, measure the residual of u0 in the
//!    continuous equation: r(s) = T (D + u0) - u0, patch averages. Followed through all bounces,
//!
//!      u(s) = u0 + (I - T0)^-1 r(s)
//!
//!    are independent solutions: the mean is the answer, the spread its standard error. The pilot's own error is of second
//!    order (a Newton step with an approximate inverse) and is measured; its rays are all that must be stored.
//! 3. *Probe.* What a field linear on patches cannot show, e - P e with e = u - u0 and P the mean over patches, acts as
//!    (I - T0)^-1 T (e - P e): the discretisation error. Rays that go one bounce further see g = T (D + u0) at a point where
//!    u0 was taken for the truth, and T (g - u0 - r) is that error but for one more bounce. Its square is estimated without the
//!    noise, as the product of independent scrambles. Where it matters it is added to the answer (a multilevel Monte Carlo
//!    correction, Heinrich 2001): light is then followed point by point over one bounce more.
//! 4. Where even that is not enough, the patches are cut into smaller ones, and their averages reported.
//!
//! The sizes of all samples are planned from what the first rounds have shown, at the least cost. An estimate is a mean, and the
//! error of one solve may be above it, the more so the fewer patches have most of it: how far is measured too, and the
//! sampling is planned to meet the tolerance two standard deviations above its mean. Few scrambles of many rays are more even
//! than many of few: four of m rays have 0.76 times the variance of eight of m / 2, and still tell it.
//!
//! - [`transport`]: rays and their sums
//! - [`pilot`]: the first operator and the first field
//! - [`measure`]: solutions by scramble, and what their spread tells
//! - [`statistics`]: errors from independent samples
//! - [`plan`]: how many rays of which kind
//! - [`solver`]: the rounds; [`stages`]: what took how long
//! - [`mod@assess`]: the true error of a solution that came from elsewhere

pub mod assess;
mod measure;
mod options;
mod pilot;
mod plan;
mod solver;
mod stages;
mod statistics;
mod transport;

pub use assess::{Assessment, assess};
pub use options::Options;
pub use solver::{Forecast, Outcome, forecast, solve};
