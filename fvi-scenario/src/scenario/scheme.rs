//! `[scheme]` and `[convolution]`: discretisation of the motion and of its fractional derivatives.

use super::system::{Damping, System};
use crate::language::document::Table;
use crate::language::error::{InputError, Problem};
use fvi_core::min_or_nan;
use fvi_fft::quadrature::starting::starting_condition;
use fvi_fft::quadrature::{ConvolutionFamily, StagedMethod};
use serde::Serialize;

/// Tolerances of equations from which on more stages take less time, in longer steps.
const STAGES_5_FROM: f64 = 1e-4;
const STAGES_7_FROM: f64 = 1e-8;

/// The integrator.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum Scheme {
    /// The low-order variational scheme with the node q_k^κ = κ q_k + (1 − κ) q_{k+1}.
    LowOrder {
        /// κ, in [0, 1]: ½ is the midpoint rule, 0 and 1 are the symplectic Euler methods.
        kappa: f64,
    },
    /// The variational scheme on polynomials of a degree.
    Galerkin {
        /// Degree s of the polynomials.
        degree: usize,
        /// The quadrature of the action; absent: that of the Runge–Kutta convolution quadrature.
        #[serde(flatten)]
        quadrature: Option<Quadrature>,
    },
    /// Collocation by the Radau IIA method of the convolution quadrature: L-stable, not variational.
    Collocation,
    /// The midpoint rule with discrete gradients, whose energy never rises by itself.
    Energy,
    /// Explicit Euler with the same memory, a baseline.
    ExplicitEuler,
    /// Implicit Euler with the same memory, a baseline.
    ImplicitEuler,
}

/// A quadrature with its number of nodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(tag = "quadrature", content = "points", rename_all = "kebab-case")]
pub enum Quadrature {
    /// Gauss–Legendre with 1 to 6 nodes.
    Gauss(usize),
    /// Gauss–Lobatto with 2 to 7 nodes.
    Lobatto(usize),
}

impl Quadrature {
    /// Number of nodes.
    pub fn points(self) -> usize {
        match self {
            Self::Gauss(points) | Self::Lobatto(points) => points,
        }
    }
}

/// Discretisation of the fractional derivatives.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Convolution {
    /// The underlying method.
    #[serde(flatten)]
    pub family: ConvolutionFamily,
    /// The nodes at which the fractional force acts.
    pub at: DampedAt,
    /// Exponents made exact by starting weights; empty: none.
    pub starting: Vec<f64>,
}

/// The nodes at which the fractional force acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum DampedAt {
    /// At the ends of the steps, as in the papers: explicit, at most of order 2 for positions and 1 for
    /// momenta.
    MainNodes,
    /// At the nodes of the action's quadrature: implicit, of order min(2 s, p) for both. Runge–Kutta families
    /// require these nodes, Euler's methods do not allow them.
    Nodes,
}

#[derive(Clone, Copy)]
enum SchemeKind {
    LowOrder,
    Galerkin,
    Collocation,
    Energy,
    ExplicitEuler,
    ImplicitEuler,
}

#[derive(Clone, Copy)]
enum FamilyName {
    Bdf,
    RadauIia,
    LobattoIiic,
    Gauss,
}

impl Default for Scheme {
    fn default() -> Self {
        Self::LowOrder { kappa: 0.5 }
    }
}

impl Scheme {
    /// The default of mechanisms, of order 4.
    pub(super) const OF_MECHANISMS: Self = Self::Galerkin { degree: 2, quadrature: None };
}

impl Default for Convolution {
    fn default() -> Self {
        Self::default_for(&Scheme::default())
    }
}

impl Scheme {
    pub(super) fn read(table: &Table<'_>) -> Result<Self, InputError> {
        // With a degree the scheme is not the default one, and needs its name.
        let named = table.optional("kind").is_some() || table.optional("degree").is_some();
        let kind = match named.then(|| table.required("kind")).transpose()? {
            None => SchemeKind::LowOrder,
            Some(kind) => kind.choice(&[
                ("low-order", SchemeKind::LowOrder),
                ("galerkin", SchemeKind::Galerkin),
                ("collocation", SchemeKind::Collocation),
                ("energy", SchemeKind::Energy),
                ("explicit-euler", SchemeKind::ExplicitEuler),
                ("implicit-euler", SchemeKind::ImplicitEuler),
                // Chosen before this table is read, see `automatic`.
                ("auto", SchemeKind::LowOrder),
            ])?,
        };
        match kind {
            SchemeKind::LowOrder => {
                table.allow(&["kind", "kappa"])?;
                let Some(value) = table.optional("kappa") else { return Ok(Self::default()) };
                let kappa = value.number()?;
                if !(0.0..=1.0).contains(&kappa) {
                    return Err(value.out_of_range("0 ≤ κ ≤ 1"));
                }
                Ok(Self::LowOrder { kappa })
            }
            SchemeKind::Galerkin => {
                table.allow(&["kind", "degree", "quadrature", "points"])?;
                let degree = table.required("degree")?.whole(1..=6)?;
                Ok(Self::Galerkin { degree, quadrature: read_quadrature(table, degree)? })
            }
            SchemeKind::Collocation => table.allow(&["kind"]).map(|()| Self::Collocation),
            SchemeKind::Energy => table.allow(&["kind"]).map(|()| Self::Energy),
            SchemeKind::ExplicitEuler => table.allow(&["kind"]).map(|()| Self::ExplicitEuler),
            SchemeKind::ImplicitEuler => table.allow(&["kind"]).map(|()| Self::ImplicitEuler),
        }
    }

    /// The scheme of equations that name none, for singular starts and stiffness.
    pub(super) fn for_equations() -> Self {
        Self::Collocation
    }

    /// The scheme with the default quadrature: a Galerkin scheme without one takes Gauss's with as many
    /// points as its degree, unless the convolution quadrature determines it.
    pub(super) fn with_quadrature_for(self, family: ConvolutionFamily) -> Self {
        match (self, family) {
            (Self::Galerkin { degree, quadrature: None }, family) if !family.is_staged() => {
                Self::Galerkin { degree, quadrature: Some(Quadrature::Gauss(degree)) }
            }
            _ => self,
        }
    }

    /// The quadrature of a Galerkin scheme; `None` if the convolution quadrature or the scheme itself
    /// determines it.
    pub fn quadrature(&self) -> Option<Quadrature> {
        match *self {
            Self::Galerkin { quadrature, .. } => quadrature,
            _ => None,
        }
    }

    /// The scheme's name with its parameters, for headings.
    pub fn describe(&self) -> String {
        match self {
            Self::LowOrder { kappa } => format!("low order, κ = {kappa}"),
            Self::Galerkin { degree, quadrature: Some(Quadrature::Gauss(points)) } => {
                format!("Galerkin, degree {degree}, Gauss {points}")
            }
            Self::Galerkin { degree, quadrature: Some(Quadrature::Lobatto(points)) } => {
                format!("Galerkin, degree {degree}, Lobatto {points}")
            }
            Self::Galerkin { degree, quadrature: None } => format!("Galerkin, degree {degree}"),
            Self::Collocation => "collocation".to_owned(),
            Self::Energy => "midpoint rule with discrete gradients".to_owned(),
            Self::ExplicitEuler => "explicit Euler".to_owned(),
            Self::ImplicitEuler => "implicit Euler".to_owned(),
        }
    }
}

/// Reads `quadrature` and `points`; `None` without either.
fn read_quadrature(table: &Table<'_>, degree: usize) -> Result<Option<Quadrature>, InputError> {
    let lobatto = match table.optional("quadrature") {
        Some(value) => value.choice(&[("gauss", false), ("lobatto", true)])?,
        None if table.optional("points").is_none() => return Ok(None),
        None => false,
    };
    // With fewer points than the degree the kinetic part would be singular.
    let fewest = if lobatto { degree.max(2) } else { degree };
    let (most, usual) = if lobatto { (7, degree + 1) } else { (6, degree) };
    let points = match table.optional("points") {
        Some(value) => value.whole(fewest..=most)?,
        None => usual,
    };
    Ok(Some(if lobatto { Quadrature::Lobatto(points) } else { Quadrature::Gauss(points) }))
}

impl DampedAt {
    /// Reads the nodes for a Runge–Kutta method, whose stages they are.
    fn of_stages(table: &Table<'_>) -> Result<Self, InputError> {
        match table.optional("at") {
            Some(value) => value.choice(&[("nodes", Self::Nodes)]),
            None => Ok(Self::Nodes),
        }
    }

    /// Reads the nodes of a multistep rule. Starting weights correct samples on the grid: with them the
    /// default is the main nodes.
    fn read(table: &Table<'_>, scheme: &Scheme, starting: bool) -> Result<Self, InputError> {
        let Some(value) = table.optional("at") else {
            return Ok(if starting { Self::MainNodes } else { Convolution::default_for(scheme).at });
        };
        value.choice(&[("nodes", Self::Nodes), ("main-nodes", Self::MainNodes)])
    }
}

impl Convolution {
    /// The default of a scenario without `[convolution]`: BDF 2 at the nodes, with which the midpoint rule is
    /// of order 2 and stable at every step. For Euler's methods, baselines of order 1, it is BDF 1 at the
    /// main nodes: the explicit one has no node inside the step, and the implicit one already solves for its
    /// end. For collocation it is Radau IIA of order 5, for the energy scheme the weights of the midpoint
    /// rule.
    pub fn default_for(scheme: &Scheme) -> Self {
        let (family, at) = match scheme {
            Scheme::LowOrder { .. } | Scheme::Galerkin { .. } => {
                (ConvolutionFamily::Bdf { order: 2 }, DampedAt::Nodes)
            }
            Scheme::Collocation => (ConvolutionFamily::RadauIia { stages: 3 }, DampedAt::Nodes),
            Scheme::Energy => (ConvolutionFamily::Gauss { stages: 1 }, DampedAt::Nodes),
            Scheme::ExplicitEuler | Scheme::ImplicitEuler => {
                (ConvolutionFamily::Bdf { order: 1 }, DampedAt::MainNodes)
            }
        };
        Self { family, at, starting: Vec::new() }
    }

    /// The default of an equation solved to a tolerance: Radau IIA of as many stages as take least time.
    pub(super) fn for_equations(tolerance: f64) -> Self {
        let stages = if tolerance > STAGES_5_FROM {
            3
        } else if tolerance > STAGES_7_FROM {
            5
        } else {
            7
        };
        Self { family: ConvolutionFamily::RadauIia { stages }, at: DampedAt::Nodes, starting: Vec::new() }
    }

    /// The default of mechanisms: the weights of the Gauss method that is the scheme.
    pub fn of_mechanism(scheme: &Scheme) -> Self {
        let stages = if let Scheme::Galerkin { degree, .. } = scheme { *degree } else { 1 };
        Self { family: ConvolutionFamily::Gauss { stages }, at: DampedAt::Nodes, starting: Vec::new() }
    }

    pub(super) fn read(table: &Table<'_>, scheme: &Scheme, is_mechanism: bool) -> Result<Self, InputError> {
        let family_value = table.optional("family");
        let is_multistep = table.optional("symbol").or(table.optional("order")).is_some()
            || table.optional("at").is_some_and(|at| at.text().is_ok_and(|at| at == "main-nodes"));
        let name = match &family_value {
            Some(value) => value.choice(&[
                ("bdf", FamilyName::Bdf),
                ("radau-iia", FamilyName::RadauIia),
                ("lobatto-iiic", FamilyName::LobattoIiic),
                ("gauss", FamilyName::Gauss),
            ])?,
            None if (is_mechanism || *scheme == Scheme::Energy) && !is_multistep => FamilyName::Gauss,
            None if *scheme == Scheme::Collocation => FamilyName::RadauIia,
            None => FamilyName::Bdf,
        };
        // The stages are the nodes of the action's quadrature too: at least as many as the degree.
        let stages = |fewest: usize, most: usize| {
            if *scheme == Scheme::Collocation && table.optional("stages").is_none() {
                return Ok(most);
            }
            let value = table.required("stages")?;
            let stages = value.whole(fewest..=most)?;
            match scheme {
                Scheme::Galerkin { degree, .. } if *degree > stages => {
                    Err(value.error(Problem::Incompatible {
                        with: format!("`scheme.degree` = {degree}"),
                        allowed: "at least as many stages as the degree".to_owned(),
                    }))
                }
                _ => Ok(stages),
            }
        };
        let (family, at) = match name {
            FamilyName::Bdf if table.optional("symbol").is_some() => {
                table.allow(&["family", "symbol", "at"])?;
                let value = table.required("symbol")?;
                let family = value.choice(&[("trapezoidal", ConvolutionFamily::Trapezoidal)])?;
                (family, DampedAt::read(table, scheme, false)?)
            }
            FamilyName::Bdf => {
                table.allow(&["family", "symbol", "order", "at", "starting"])?;
                let family = match table.optional("order") {
                    Some(value) => ConvolutionFamily::Bdf { order: value.whole(1..=6)? },
                    None if matches!(scheme, Scheme::ExplicitEuler | Scheme::ImplicitEuler) => {
                        ConvolutionFamily::Bdf { order: 1 }
                    }
                    None => ConvolutionFamily::Bdf { order: 2 },
                };
                let starting = match table.optional("starting") {
                    Some(value) => !value.numbers()?.is_empty(),
                    None => false,
                };
                (family, DampedAt::read(table, scheme, starting)?)
            }
            FamilyName::RadauIia => {
                table.allow(&["family", "stages", "at", "starting"])?;
                let stages = match (table.optional("stages"), *scheme) {
                    (Some(value), Scheme::Collocation) => {
                        let stages = value.whole(1..=7)?;
                        if !StagedMethod::STAGES_OF_RADAU_IIA.contains(&stages) {
                            return Err(value.out_of_range("1, 2, 3, 5 or 7"));
                        }
                        stages
                    }
                    _ => stages(1, 3)?,
                };
                (ConvolutionFamily::RadauIia { stages }, DampedAt::of_stages(table)?)
            }
            FamilyName::LobattoIiic => {
                table.allow(&["family", "stages", "at", "starting"])?;
                (ConvolutionFamily::LobattoIiic { stages: stages(2, 4)? }, DampedAt::of_stages(table)?)
            }
            FamilyName::Gauss => {
                table.allow(&["family", "at", "starting"])?;
                (Self::of_mechanism(scheme).family, DampedAt::of_stages(table)?)
            }
        };
        let starting = match table.optional("starting") {
            Some(value) => {
                let exponents = value.numbers()?;
                let distinct =
                    exponents.iter().enumerate().all(|(i, a)| exponents[..i].iter().all(|b| a != b));
                if !distinct || exponents.iter().any(|&exponent| exponent < 0.0) {
                    return Err(value.out_of_range("distinct exponents ≥ 0"));
                }
                if !starting_condition(&exponents).is_finite() {
                    let reason =
                        "exponents so far apart that the system of their starting weights is not singular";
                    return Err(value.out_of_range(reason));
                }
                exponents
            }
            None => Vec::new(),
        };
        Ok(Self { family, at, starting })
    }

    /// The largest exponent whose starting weights do not grow with time: p + β, with the lowest order β of a
    /// damping term.
    ///
    /// The quadrature's error on t^ν, which the starting weights correct, grows like h^p t^(ν − β − p):
    /// beyond, a fixed multiple of the first samples acts as a force that grows without bound. A derivative
    /// of order 0 has no error.
    pub(super) fn highest_exponent(&self, system: &System) -> f64 {
        let ConvolutionFamily::Bdf { order } = self.family else { return f64::INFINITY };
        let whole = |term: &&Damping| term.transfer.exponent() != Some(0.0);
        let orders = system.damping.iter().filter(whole).map(|term| term.transfer.growth());
        order as f64 + orders.fold(f64::INFINITY, min_or_nan)
    }

    /// Refuses larger exponents.
    pub(super) fn check_exponents(&self, table: &Table<'_>, system: &System) -> Result<(), InputError> {
        let highest = self.highest_exponent(system);
        let Some(value) = table.optional("starting") else { return Ok(()) };
        match value.list("a list of numbers")?.iter().zip(&self.starting).find(|(_, nu)| **nu > highest) {
            Some((entry, _)) => Err(entry.out_of_range(format!(
                "exponents up to {highest}, `convolution.order` plus the lowest `system.damping` order: the starting weights of higher \
                 ones grow with time; take a higher `convolution.order`, or set `time.allow_unstable = true` to run anyway"
            ))),
            None => Ok(()),
        }
    }

    /// The quadrature's name with its parameters, for headings.
    pub fn describe(&self) -> String {
        let family = match self.family {
            ConvolutionFamily::Bdf { order } if self.at == DampedAt::Nodes => {
                format!("BDF {order} at the nodes")
            }
            ConvolutionFamily::Bdf { order } => format!("BDF {order} at the main nodes"),
            ConvolutionFamily::Trapezoidal => "trapezoidal rule at the nodes".to_owned(),
            ConvolutionFamily::RadauIia { stages } => format!("Radau IIA, {stages} stages"),
            ConvolutionFamily::LobattoIiic { stages } => format!("Lobatto IIIC, {stages} stages"),
            ConvolutionFamily::Gauss { stages: 1 } => "Gauss, 1 stage".to_owned(),
            ConvolutionFamily::Gauss { stages } => format!("Gauss, {stages} stages"),
        };
        if self.starting.is_empty() { family } else { format!("{family} with starting weights") }
    }
}
