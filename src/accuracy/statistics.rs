//! What independent scrambles of one sample tell of its error: of every number, and of all together.

use std::borrow::Cow;

use crate::direct::SCRAMBLES;
use crate::scene::Scene;

/// What errors of the irradiance count for: A rho^2, or A in a band that nothing reflects.
pub(super) struct Weight<'a> {
    scene: &'a Scene,
    /// Whether anything reflects in a band.
    reflects: Vec<bool>,
}

impl Weight<'_> {
    pub(super) fn new(scene: &Scene) -> Weight<'_> {
        let bands = scene.bands();
        let reflects =
            (0..bands).map(|b| scene.reflectance().iter().skip(b).step_by(bands).any(|rho| *rho > 0.0)).collect();
        Weight { scene, reflects }
    }

    /// That of number k of n x b.
    pub(super) fn of(&self, k: usize) -> f64 {
        let bands = self.reflects.len();
        let rho = if self.reflects[k % bands] { self.scene.reflectance()[k] } else { 1.0 };
        self.scene.areas()[k / bands] * rho * rho
    }
}

/// One band of an irradiance as the unit of others.
pub(super) struct Unit<'a> {
    weight: &'a Weight<'a>,
    band: usize,
    /// Its largest number, and the weighted sum of squares in units of that: squares neither overflow nor vanish.
    peak: f64,
    square: f64,
}

impl<'a> Unit<'a> {
    pub(super) fn new(weight: &'a Weight<'a>, band: usize, irradiance: &[f64]) -> Unit<'a> {
        let peak = irradiance.iter().skip(band).step_by(weight.reflects.len()).fold(0.0f64, |m, x| m.max(x.abs()));
        let mut unit = Unit { weight, band, peak, square: 1.0 };
        unit.square = unit.product(irradiance, irradiance);
        unit
    }

    /// The weighted inner product of two irradiances in units of this one's square; 0 where that is 0.
    pub(super) fn product(&self, x: &[f64], y: &[f64]) -> f64 {
        if !(self.peak > 0.0 && self.square > 0.0) {
            return 0.0;
        }
        let numbers = (self.band..x.len()).step_by(self.weight.reflects.len());
        numbers.map(|k| self.weight.of(k) * (x[k] / self.peak) * (y[k] / self.peak)).sum::<f64>() / self.square
    }
}

/// The mean of what the scrambles say, and its standard error, component by component.
pub(super) fn mean_and_error<'a>(of_scramble: impl Fn(usize) -> Cow<'a, [f64]>) -> (Vec<f64>, Vec<f64>) {
    let count = SCRAMBLES as f64;
    let mut mean = of_scramble(0).into_owned();
    for s in 1..SCRAMBLES {
        mean.iter_mut().zip(of_scramble(s).iter()).for_each(|(mean, x)| *mean += x);
    }
    mean.iter_mut().for_each(|mean| *mean /= count);
    let mut error = vec![0.0f64; mean.len()];
    for s in 0..SCRAMBLES {
        let x = of_scramble(s);
        // No square of a large number.
        error.iter_mut().zip(&mean).zip(x.iter()).for_each(|((error, mean), x)| *error = error.hypot(x - mean));
    }
    error.iter_mut().for_each(|error| *error /= (count * (count - 1.0)).sqrt());
    (mean, error)
}

/// |E x|^2 of independent vectors x_s of one mean by their inner products, without bias, and the standard error of that.
pub(super) fn square_of_mean(x: &[Cow<[f64]>], product: impl Fn(&[f64], &[f64]) -> f64) -> (f64, f64) {
    if x.len() < 2 {
        return (0.0, 0.0);
    }
    let pairs: Vec<(usize, usize)> = (1..x.len()).flat_map(|s| (0..s).map(move |t| (s, t))).collect();
    let products: Vec<f64> = pairs.iter().map(|&(s, t)| product(&x[s], &x[t])).collect();
    let mean = |with: &dyn Fn(usize) -> bool| {
        let chosen = || pairs.iter().zip(&products).filter(|((s, t), _)| with(*s) && with(*t)).map(|(_, p)| *p);
        chosen().sum::<f64>() / chosen().count() as f64
    };
    let (square, number, count) = (mean(&|_| true), products.len() as f64, x.len() as f64);
    // Products of different pairs are uncorrelated where the mean is 0; where it is not, those of one vector rise and fall with
    // it, which leaving out one vector after the other shows (the jackknife, Quenouille 1956; Arvesen 1969).
    let spread = products.iter().map(|p| (p - square).powi(2)).sum::<f64>() / (number - 1.0) / number;
    let without = (0..x.len()).map(|left_out| (mean(&|s| s != left_out) - square).powi(2)).sum::<f64>();
    let jackknife = if x.len() > 2 { (count - 1.0) / count * without } else { 0.0 };
    (square, spread.max(jackknife).sqrt())
}

/// The standard deviation of |x - E x|^2 in units of its mean, by the inner products of independent vectors x_s that have had
/// their mean taken off. With covariance C that is (2 tr C^2)^(1/2) / tr C for normal x: next to nothing where many
/// components vary on their own, 2^(1/2) where all vary as one.
pub(super) fn spread_of_square(x: &[Cow<[f64]>], product: impl Fn(&[f64], &[f64]) -> f64) -> f64 {
    let n = x.len() as f64;
    let trace = x.iter().map(|x| product(x, x)).sum::<f64>() / (n - 1.0);
    if !(trace > 0.0) {
        return 0.0;
    }
    // The product of two is -tr C / n in the mean, because the mean was taken off, and has the variance c tr C^2 about that.
    let c = (1.0 - 1.0 / n).powi(2) + 1.0 / (n * n) - 2.0 / (n * n * (n - 1.0));
    let pairs = (1..x.len()).flat_map(|s| (0..s).map(move |t| (s, t)));
    let squares: f64 = pairs.map(|(s, t)| (product(&x[s], &x[t]) / trace + 1.0 / n).powi(2)).sum();
    let of_square = squares / (0.5 * n * (n - 1.0)) / c;
    // The square of the trace is itself too large by 2 tr C^2 / (n - 1) in the mean.
    (2.0 * of_square / (1.0 - 2.0 * of_square / (n - 1.0)).max(0.5)).sqrt()
}
