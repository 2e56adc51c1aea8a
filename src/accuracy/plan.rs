//! How many rays of which kind meet a goal at the least cost.
//!
//! With variances V_t that fall as m_t^-p and costs c_t m_t, Lagrange's multiplier gives growth factors f_t with
//! f_t^(p+1) in proportion to V_t / c_t, and sum over t of V_t f_t^-p = goal fixes their scale.

/// Exponent p of the variance m^-p of a mean over m quasi-random rays: errors fall about as m^-0.7.
pub(super) const DECAY: f64 = 1.4;
/// A round grows a sample by no less, if at all: a round has its own cost.
const LEAST_GROWTH: f64 = 1.15;
/// Growth that is not worth a round: [`DECAY`] is not known so well.
const MET: f64 = 1.05;
/// The discretisation error is surely there when its square is so many times the standard error of that.
const SURE: f64 = 4.0;
/// By how much the probe grows when nothing but more of it can tell.
const PROBE_GROWTH: f64 = 2.0;
/// How much of the discretisation error is left, at most, when light is followed one bounce further.
const LEFT: f64 = 0.35;
/// The sampling is to meet its goal even if its squared error comes out so many standard deviations above its mean.
const CARE: f64 = 2.0;
/// Share of the squared goal that the doubt about the discretisation error may take.
const DOUBT: f64 = 0.2;
/// Share of it that must be left for sampling.
const LEAST: f64 = 0.3;

/// The samples, in this order everywhere: segments to lamps, base rays, probe rays.
pub(super) const KINDS: usize = 3;
const BASE: usize = 1;
const PROBE: usize = 2;

/// What is known of the error, squared, in units of the answer's square.
#[derive(Debug, Clone, Copy)]
pub(super) struct Errors {
    /// Of the sampling, by kind; the probe's counts only when it is added to the answer.
    pub(super) variances: [f64; KINDS],
    /// The standard deviation of the squared error of sampling, in units of its mean, without and with the probe added: large
    /// where few patches have most of it, or all share one.
    pub(super) spreads: [f64; 2],
    /// What the pilot's operator leaves, which no sample lowers.
    pub(super) pilot: f64,
    /// The discretisation error: an estimate without bias, which may be negative.
    pub(super) discretisation: f64,
    /// The standard error of that estimate.
    pub(super) doubt: f64,
}

impl Errors {
    /// The part of sampling, and the part of discretisation.
    pub(super) fn parts(&self, corrected: bool) -> [f64; 2] {
        let [direct, base, probe] = self.variances;
        let discretisation = self.discretisation.max(0.0);
        let sampling = self.pilot + direct + base + if corrected { probe } else { 0.0 };
        [sampling, if corrected { LEFT * LEFT * discretisation } else { discretisation }]
    }

    /// The squared error of the uncorrected answer where that of sampling is [`CARE`] standard deviations above its mean.
    pub(super) fn at_worst(&self) -> f64 {
        let [sampling, discretisation] = self.parts(false);
        sampling * self.care(false) + discretisation
    }

    fn care(&self, corrected: bool) -> f64 {
        1.0 + CARE * self.spreads[usize::from(corrected)]
    }
}

/// What to do next.
#[derive(Debug, Clone, Copy)]
pub(super) struct Plan {
    /// By which samples are to grow, none below 1.
    factors: [f64; KINDS],
    /// Whether the probe is to be added to the answer.
    pub(super) corrected: bool,
}

impl Plan {
    /// There is nothing to do, or nothing that would help.
    pub(super) const DONE: Plan = Plan { factors: [1.0; KINDS], corrected: false };

    /// Whether nothing is to grow.
    pub(super) fn is_met(&self) -> bool {
        self.factors.iter().all(|factor| *factor <= MET)
    }

    /// What the growth costs.
    pub(super) fn extra_cost(&self, costs: &[f64; KINDS]) -> f64 {
        self.factors.iter().zip(costs).map(|(factor, cost)| (factor - 1.0) * cost).sum()
    }

    /// The base grows with the probe where that would have more rays: the probe holds the residuals that the base has measured,
    /// and their noise is a part of the doubt.
    fn with_base(mut self, costs: &[f64; KINDS]) -> Plan {
        // A probe ray is two rays.
        if self.factors[PROBE] > MET && costs[BASE] > 0.0 {
            let least = 0.5 * costs[PROBE] * self.factors[PROBE] / costs[BASE];
            self.factors[BASE] = self.factors[BASE].max(least);
        }
        self
    }

    /// Sample sizes after it, none grown by more than `most`.
    pub(super) fn grown(&self, sizes: [u32; KINDS], most: f64) -> [u32; KINDS] {
        std::array::from_fn(|t| {
            let factor = if self.factors[t] > MET { self.factors[t].clamp(LEAST_GROWTH, most) } else { 1.0 };
            let size = f64::from(sizes[t]) * factor;
            size.ceil().min(f64::from(u32::MAX / 64)) as u32
        })
    }
}

/// The cheapest way to bring the squared error down to `goal`; `None` when the patches are too coarse for any.
pub(super) fn cheapest(errors: &Errors, costs: &[f64; KINDS], goal: f64, refine: bool) -> Option<Plan> {
    let (known, doubt) = (errors.discretisation.max(0.0), errors.doubt);
    let goal = (goal - errors.pilot).max(LEAST * goal);
    let reserve = doubt.min(DOUBT * goal);
    let growth = |left: f64, kinds: &[usize], corrected: bool| {
        growth(&errors.variances.map(|variance| variance * errors.care(corrected)), costs, left, kinds)
    };
    // Without correction: the sampling down to `left`, and the doubt to `sure`.
    let uncorrected = |left: f64, sure: f64| {
        let mut factors = growth(left, &[0, BASE], false);
        factors[PROBE] = (doubt / sure).max(1.0).powf(1.0 / DECAY);
        Plan { factors, corrected: false }.with_base(costs)
    };
    let left = goal - known - reserve;
    let plain = (left >= LEAST * goal).then(|| uncorrected(left, DOUBT * goal));
    if plain.is_some_and(|plan| plan.is_met()) {
        return plain;
    }
    let cheaper = |plans: [Option<Plan>; 2]| {
        plans.into_iter().flatten().min_by(|p, q| p.extra_cost(costs).total_cmp(&q.extra_cost(costs)))
    };
    // What may be noise is neither corrected, nor are patches cut for it. The sampling goes as far as it must without such an
    // error; from there it goes on, or the probe until more is known, whichever is cheaper.
    if known < SURE * doubt {
        let least = uncorrected(goal - reserve, (DOUBT * goal).max(known / SURE));
        let more = Plan { factors: [1.0, 1.0, PROBE_GROWTH], corrected: false }.with_base(costs);
        return if least.is_met() { cheaper([plain, Some(more)]) } else { Some(least) };
    }
    if !refine {
        // What the patches cannot show is not to be had: sampling need not be finer than a part of that.
        return Some(plain.unwrap_or_else(|| uncorrected((LEAST * goal).max(0.1 * known), goal.max(known))));
    }
    let left = goal - LEFT * LEFT * (known + doubt);
    let corrected =
        (left >= LEAST * goal).then(|| Plan { factors: growth(left, &[0, BASE, PROBE], true), corrected: true });
    cheaper([plain, corrected])
}

/// The factors by which the samples of these kinds must grow to bring the sum of their variances down to `goal`, none below 1.
fn growth(variances: &[f64; KINDS], costs: &[f64; KINDS], goal: f64, kinds: &[usize]) -> [f64; KINDS] {
    let mut factors = [1.0; KINDS];
    let total: f64 = kinds.iter().map(|&t| variances[t]).sum();
    if total <= goal {
        return factors;
    }
    let mut active: Vec<usize> = kinds.iter().copied().filter(|&t| variances[t] > 0.0 && costs[t] > 0.0).collect();
    // Those that are large enough already leave the others less to spend: one drops out a turn.
    while !active.is_empty() {
        let fixed: f64 = kinds.iter().filter(|t| !active.contains(t)).map(|&t| variances[t]).sum();
        let left = (goal - fixed).max(0.05 * goal);
        let share = |t: usize| (variances[t] / costs[t]).powf(1.0 / (DECAY + 1.0));
        let sum: f64 = active.iter().map(|&t| variances[t] * share(t).powf(-DECAY)).sum();
        let scale = (sum / left).powf(1.0 / DECAY);
        let Some(least) = active.iter().copied().min_by(|&s, &t| share(s).total_cmp(&share(t))) else { break };
        if scale * share(least) >= 1.0 {
            active.iter().for_each(|&t| factors[t] = scale * share(t));
            break;
        }
        active.retain(|&t| t != least);
    }
    factors
}
