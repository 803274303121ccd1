//! Warnings about settings that are allowed but give results with lower accuracy or another meaning than
//! expected.

use super::Scenario;
use super::adaptive::Adaptive;
use super::scheme::DampedAt;
use super::system::{Damping, Derivative};
use crate::language::expression::{Function, Kind, Node, Operator};
use fvi_fft::quadrature::ConvolutionFamily;
use fvi_fft::quadrature::starting::{TRUSTED_CONDITION, starting_condition};
use fvi_fft::sums::max_or_nan;

impl Scenario {
    /// Warnings about the scenario, a sentence or two each, with the key in front.
    pub fn warnings(&self) -> Vec<String> {
        let starting = self.starting_warning();
        let terms = self.system.damping.iter().enumerate();
        let singular = terms.filter_map(|(index, term)| self.singular_force_warning(index, term));
        let growing = self.growing_warning();
        let lowering = self.lowering_warning();
        let jumps = self.jumps_warning();
        let default = self.default_order_warning();
        let of_starting = starting.into_iter().chain(growing).chain(lowering);
        let start = self.start_warning();
        let further = start.into_iter().chain(jumps).chain(self.off_grid_warning());
        let amended = self.system.damping.iter().enumerate().flat_map(|(index, term)| {
            term.notes().iter().map(move |note| format!("system.damping[{index}].kernel: {note}"))
        });
        of_starting
            .chain(default)
            .chain(singular)
            .chain(amended)
            .chain(further)
            .chain(self.equal_steps_warning())
            .collect()
    }

    /// Warns of a scheme of high order beside a memory of order 2 that nobody asked for.
    fn default_order_warning(&self) -> Option<String> {
        let descriptor = self.scheme_descriptor();
        let degree = if descriptor.is_variational { descriptor.unknowns } else { 1 };
        let is_low = self.convolution.family == ConvolutionFamily::Bdf { order: 2 };
        let acts = self.system.damping.iter().any(|term| term.transfer.exponent() != Some(0.0));
        // Which reads the file's text again, last.
        let is_asked = || self.automatic.is_some() || self.document().has("convolution");
        (degree > 1 && is_low && acts && !is_asked()).then(|| {
            format!(
                "convolution: without this table the memory has order 2, and so has the motion, by a scheme of order {}; \
                 `family` = \"gauss\" has the scheme's order, `order` up to 6 that of backward differentiation",
                2 * degree
            )
        })
    }

    /// Warns of starting weights that their exponents do not determine.
    fn starting_warning(&self) -> Option<String> {
        let condition = starting_condition(&self.convolution.starting);
        (condition > TRUSTED_CONDITION).then(|| {
            format!(
                "convolution.starting: the system of the starting weights has condition {condition:.1e}; \
                 above {TRUSTED_CONDITION:.0e} they are more rounding than weights: take fewer exponents"
            )
        })
    }

    /// Warns of growing starting weights, in a scenario that allows them.
    fn growing_warning(&self) -> Option<String> {
        let highest = self.convolution.highest_exponent(&self.system);
        self.convolution.starting.iter().any(|&nu| nu > highest).then(|| {
            format!("convolution.starting: the starting weights of exponents above {highest} grow with time")
        })
    }

    /// Warns of starting weights that lower the order. Those of large exponents put large weights on the
    /// first samples: if Caputo's q − q₀ (− v₀ t) begins with a lower power than the exponents, they are less
    /// accurate than plain weights, which have full order up to 2. Measured with BDF 2: for β = ½ and v₀ ≠ 0
    /// order 1.5 with ν = 1, 1 with 2, ½ with 2.5; from rest 1.5 with 2.5; for β = 3/2 1.5 with any.
    fn lowering_warning(&self) -> Option<String> {
        let some = |numbers: &[f64]| numbers.iter().any(|&number| number != 0.0);
        let (moves, is_off) = (some(&self.initial.momentum), some(&self.initial.position));
        let highest = self.convolution.starting.iter().copied().fold(0.0, max_or_nan);
        let lowers = |term: &Damping| {
            let order = term.transfer.growth();
            let is_taken_worse = moves || (is_off && (order > 1.0 || highest > 2.0));
            let acts = term.transfer.exponent() != Some(0.0);
            term.derivative == Derivative::Caputo && acts && is_taken_worse
        };
        (!self.convolution.starting.is_empty() && self.system.damping.iter().any(lowers)).then(|| {
            "convolution.starting: where Caputo damping begins from a state that is not zero starting weights can lower the \
             order, to 1 and less: compare with `starting = []` by `fvi converge`"
                .to_owned()
        })
    }

    /// Warns of a start that no step resolves.
    fn start_warning(&self) -> Option<String> {
        let rule = self.time.adaptive()?;
        let from = rule.momenta_from()?;
        let asked = match rule.asked {
            0.0 => "less than 1e-323".to_owned(),
            asked => format!("{asked:.1e}"),
        };
        Some(format!(
            "time.tolerance: Riemann–Liouville damping from an initial state that is not zero lets the momentum begin like \
             t^{:.3}, for which a first step of {asked} would have to be made: positions are held to the tolerance from the \
             beginning, momenta from t = {from:.1e} on",
            rule.start.power
        ))
    }

    /// Warns of equal steps through the singular start of an equation.
    fn equal_steps_warning(&self) -> Option<String> {
        self.equation.as_ref()?;
        let power = Adaptive::start(&self.system, &self.initial).creep;
        (self.time.grid.is_none() && power < 1.0).then(|| {
            format!(
                "time.step: the solution begins like t^{power}, which the first of equal steps do not resolve; `end` and \
                 `tolerance` without a step choose steps that do"
            )
        })
    }

    /// True if a force has `step` or `sign` of a velocity, as friction and dampers c sign(v)|v|^γ.
    #[doc(hidden)]
    pub fn jumps_with_velocities(&self) -> bool {
        let with_velocity = |argument: &Node| argument.has_variable_from(self.coordinates());
        let mut components = self.system.force.iter().flatten();
        components.any(|component| jumps(component.root(), &with_velocity))
    }

    /// Warns of forces that jump in the position, if steps do not end at the jumps.
    fn jumps_warning(&self) -> Option<String> {
        let mut components = self.system.force.iter().flatten();
        let with_velocity = |argument: &Node| argument.has_variable_from(self.coordinates());
        if components.clone().any(|component| jumps_beyond_kinks(component.root(), &with_velocity)) {
            return Some(
                "system.force: `step` or `sign` of a velocity jumps inside of steps, which leaves the order 1 at best; no \
                 steps end there: take a smooth function, as `tanh(v0/w)` with a small w"
                    .to_owned(),
            );
        }
        let with_position = |argument: &Node| argument.varies() && !with_velocity(argument);
        let force = components.any(|component| jumps_beyond_kinks(component.root(), &with_position));
        let mut potential = self.system.potential.iter();
        let potential = potential.any(|potential| jumps_beyond_kinks(potential.root(), &with_position));
        let (key, what) = match (&self.equation, force) {
            (Some(_), _) => ("equation.right", "an unknown"),
            (None, true) => ("system.force", "the position"),
            (None, false) => ("system.potential", "the position"),
        };
        ((force || potential) && self.time.adaptive().is_none()).then(|| {
            format!(
                "{key}: `step` or `sign` of {what} jumps inside of steps, which leaves the order 1 at best; \
                 `time.grid` = \"adaptive\" ends steps there"
            )
        })
    }

    /// Warns of the Riemann–Liouville derivative of a position that does not start at zero. With plain
    /// weights at the nodes there is no warning.
    ///
    /// It contains q₀ t^(−β)/Γ(1 − β). The sum at the main nodes begins with the first step, without the kick
    /// −h ρ w₀ q₀ at t = 0, which is of the order h^(1−β); a derivative of order 0 has no singularity, and
    /// for β = 1 and BDF 1 the sum is the difference quotient (q_k − q_{k−1})/h, which is correct. The stages
    /// of a Runge–Kutta method resolve the kick as long as it has a limit: with Radau IIA the error of q
    /// falls like h^(2−β).
    fn singular_force_warning(&self, index: usize, term: &Damping) -> Option<String> {
        let force = term.coefficient.times(self.initial.base());
        let beta = term.transfer.growth();
        let at_stages = self.convolution.family.is_staged();
        if term.derivative == Derivative::Caputo
            || beta == 0.0
            || (self.convolution.at == DampedAt::Nodes && !at_stages)
            || force.iter().all(|&entry| entry == 0.0)
        {
            return None;
        }
        let linear_damper = beta == 1.0 && self.convolution.family == (ConvolutionFamily::Bdf { order: 1 });
        if linear_damper || (at_stages && beta < 1.0) {
            return None;
        }
        let consequence = if beta > 1.0 {
            "has no integral over the first step, so that the motion has no limit as `time.step` goes to 0"
                .to_owned()
        } else if beta == 1.0 && at_stages {
            "holds the kick −ρ q of a jump to the initial position, which a linear damper does not have"
                .to_owned()
        } else if beta == 1.0 {
            "is counted differently by each `convolution.order`, at every `time.step`; order 1 gives linear damping"
                .to_owned()
        } else {
            let order = 1.0 - beta;
            format!(
                "is not resolved by the first step: the error falls like h^{order:.3} only; Runge–Kutta quadrature resolves it"
            )
        };
        Some(format!(
            "system.damping[{index}].derivative: with an initial position that is not 0 the Riemann–Liouville derivative of \
             order {beta} has a singular part q(0) t^-{beta} which {consequence}; derivative = \"caputo\" has none, and \
             `convolution.at` = \"nodes\" takes it in"
        ))
    }

    /// Warns of a table of known values at times that are not grid points.
    fn off_grid_warning(&self) -> Option<String> {
        let count = self.reference.as_ref()?.off_grid(&self.time, &self.output);
        (count > 0)
            .then(|| format!("reference.file: {count} of its times are not grid points and are not compared"))
    }
}

/// True if an expression contains a jump whose argument varies and passes a test.
fn jumps(node: &Node, test: &dyn Fn(&Node) -> bool) -> bool {
    node.any(&|part| match part.kind() {
        Kind::Call(Function::Step | Function::Sign, argument) => argument.varies() && test(argument),
        _ => false,
    })
}

/// As [`jumps`], but for products that vanish where they jump, as sign(v)|v|^γ.
fn jumps_beyond_kinks(node: &Node, test: &dyn Fn(&Node) -> bool) -> bool {
    let inside = |part: &Node| jumps_beyond_kinks(part, test);
    let (mut factors, mut divisors) = (Vec::new(), Vec::new());
    collect_factors(node, &mut factors, &mut divisors);
    let vanishes = |argument: &Node| factors.iter().any(|factor| power_of(factor, argument).is_some());
    let jumps = |factor: &Node| match factor.kind() {
        Kind::Call(Function::Step | Function::Sign, argument) => {
            test(argument) && !vanishes(positive(argument))
        }
        Kind::Call(_, part) => inside(part),
        Kind::Chain(first, operands) => inside(first) || operands.iter().any(|(_, part)| inside(part)),
        Kind::Power(sides) | Kind::Choice(_, sides) => sides.iter().any(inside),
        Kind::Negation(_) | Kind::Number(_) | Kind::Time | Kind::SidedTime | Kind::Variable(_) => false,
    };
    factors.iter().any(|factor| jumps(factor)) || divisors.iter().any(|part| inside(part))
}

/// The factors of nested products, without their signs, and what divides them; of a sum, itself.
fn collect_factors<'n>(node: &'n Node, factors: &mut Vec<&'n Node>, divisors: &mut Vec<&'n Node>) {
    match node.kind() {
        Kind::Negation(part) => collect_factors(part, factors, divisors),
        Kind::Chain(first, operands) if operands.iter().all(|(operator, _)| !operator.is_additive()) => {
            collect_factors(first, factors, divisors);
            for (operator, part) in operands {
                match operator {
                    Operator::Divide => divisors.push(part),
                    _ => collect_factors(part, factors, divisors),
                }
            }
        }
        _ => factors.push(node),
    }
}

/// A part without its sign.
fn positive(node: &Node) -> &Node {
    match node.kind() {
        Kind::Negation(part) => positive(part),
        _ => node,
    }
}

/// The power of an argument that a factor is: the argument, its modulus, or a power or root of that.
fn power_of(factor: &Node, argument: &Node) -> Option<f64> {
    match factor.kind() {
        _ if factor == argument => Some(1.0),
        Kind::Negation(part) | Kind::Call(Function::Abs, part) => power_of(part, argument),
        Kind::Call(Function::Sqrt, part) => Some(0.5 * power_of(part, argument)?),
        Kind::Power(sides) => {
            let [base, exponent] = sides.as_ref();
            Some(exponent.as_number().filter(|exponent| *exponent > 0.0)? * power_of(base, argument)?)
        }
        _ => None,
    }
}

/// True if an expression has jumps or kinks in unknowns, other than in products whose slope is continuous, as
/// v|v|.
pub(super) fn bends(node: &Node) -> bool {
    let (mut factors, mut divisors) = (Vec::new(), Vec::new());
    collect_factors(node, &mut factors, &mut divisors);
    // Of a product |a|^γ, with or without the sign of a.
    let power = |argument: &Node| factors.iter().filter_map(|factor| power_of(factor, argument)).sum::<f64>();
    let bent = |factor: &Node| match factor.kind() {
        Kind::Call(Function::Step | Function::Sign | Function::Abs, argument) if argument.varies() => {
            power(positive(argument)) <= 1.0 || bends(argument)
        }
        Kind::Power(sides) => match sides[0].kind() {
            Kind::Call(Function::Abs, argument) if argument.varies() => {
                power(positive(argument)) <= 1.0 || bends(argument) || bends(&sides[1])
            }
            _ => sides.iter().any(bends),
        },
        Kind::Call(_, part) => bends(part),
        Kind::Choice(function, _) if function.selects() && factor.varies() => true,
        Kind::Chain(first, operands) => bends(first) || operands.iter().any(|(_, part)| bends(part)),
        Kind::Choice(_, sides) => sides.iter().any(bends),
        Kind::Negation(_) | Kind::Number(_) | Kind::Time | Kind::SidedTime | Kind::Variable(_) => false,
    };
    factors.iter().any(|factor| bent(factor)) || divisors.iter().any(|part| bends(part))
}
