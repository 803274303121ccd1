//! Conversion of an expression tree to a graph, with derivatives up to a given order.
//!
//! Differentiation is forward and sparse, with derivatives that are identically zero left out: the cost of a
//! sum of terms with few variables each is that of its terms.

use super::graph::{Graph, Origin, Value};
use super::operation::Operation;
use super::sides::SideArguments;
use fvi_scenario::language::expression::{Function, Kind, Node, Operator};

/// Highest order of derivatives.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Order {
    Value,
    Gradient,
    Hessian,
}

/// Row and column of an entry of a Hessian's lower triangle.
pub(super) type Entry = (u32, u32);

/// A value with its derivatives; those that are identically zero are left out.
#[derive(Clone, Debug)]
pub(super) struct Derivatives {
    pub(super) value: Value,
    /// ∂/∂q_i, ascending in i.
    pub(super) gradient: Vec<(u32, Value)>,
    /// ∂²/∂q_i∂q_j with i ≥ j, ascending in (i, j).
    pub(super) hessian: Vec<(Entry, Value)>,
}

impl Derivatives {
    fn constant(value: Value) -> Self {
        Self { value, gradient: Vec::new(), hessian: Vec::new() }
    }
}

/// Index of the derivative along a direction.
pub(super) const ALONG: u32 = u32::MAX;

impl Graph {
    /// Adds the tree to the graph.
    pub(super) fn differentiate(&mut self, node: &Node, order: Order) -> Derivatives {
        Differentiation { graph: self, order, sides: None, along: None }.node(node)
    }

    /// Adds the tree to the graph, with the sides of jumps and kinks as inputs.
    pub(super) fn differentiate_sided(
        &mut self,
        node: &Node,
        order: Order,
        sides: &mut SideArguments,
    ) -> Derivatives {
        Differentiation { graph: self, order, sides: Some(sides), along: None }.node(node)
    }

    /// Adds the tree in `width` variables x and `constants` further ones θ to the graph. Its derivatives are
    /// those by θ and along a direction λ, whose components are variables after θ: the index [`ALONG`] stands
    /// for Σ λ_i ∂/∂x_i. The entries of the Hessian are those of the row of this index by θ.
    pub(super) fn differentiate_along(&mut self, node: &Node, [width, constants]: [u32; 2]) -> Derivatives {
        let along = Some([width, constants]);
        Differentiation { graph: self, order: Order::Hessian, sides: None, along }.node(node)
    }
}

/// True for a fixed exponent that is no whole number, or one that varies.
fn is_root(exponent: &Node) -> bool {
    match exponent.kind() {
        Kind::Number(number) => number.fract() != 0.0,
        _ => true,
    }
}

/// The g of a factor |g|^e with a fixed e > 0 that is no whole number, or √|g|.
fn size_below_root(factor: &Node) -> Option<&Node> {
    let base = match factor.kind() {
        Kind::Power(sides) => {
            let [base, exponent] = sides.as_ref();
            let is_positive = matches!(exponent.kind(), Kind::Number(number) if *number > 0.0);
            (is_positive && is_root(exponent)).then_some(base)?
        }
        Kind::Call(Function::Sqrt, argument) => argument.as_ref(),
        Kind::Negation(inner) => return size_below_root(inner),
        _ => return None,
    };
    match base.kind() {
        Kind::Call(Function::Abs, argument) => Some(argument.as_ref()),
        _ => None,
    }
}

struct Differentiation<'a> {
    graph: &'a mut Graph,
    order: Order,
    /// The jumps and kinks whose sides are inputs, if any.
    sides: Option<&'a mut SideArguments>,
    /// Numbers of variables and constants, if variables are differentiated along a direction.
    along: Option<[u32; 2]>,
}

impl Differentiation<'_> {
    fn node(&mut self, node: &Node) -> Derivatives {
        match node.kind() {
            Kind::Number(number) => Derivatives::constant(self.graph.constant(*number)),
            Kind::Time => Derivatives::constant(self.graph.insert(Origin::Time)),
            Kind::SidedTime => Derivatives::constant(self.graph.insert(Origin::SidedTime)),
            Kind::Variable(index) => {
                let index = u32::try_from(*index).expect("a variable's index is below 2³²");
                let value = self.graph.insert(Origin::Variable(index));
                let slope = (self.order >= Order::Gradient).then(|| match self.along {
                    Some([width, constants]) if index < width => {
                        (ALONG, self.graph.insert(Origin::Variable(width + constants + index)))
                    }
                    _ => (index, self.graph.constant(1.0)),
                });
                Derivatives { gradient: slope.into_iter().collect(), ..Derivatives::constant(value) }
            }
            Kind::Negation(inner) => {
                let inner = self.node(inner);
                Derivatives {
                    value: self.graph.negate(inner.value),
                    gradient: self.each(inner.gradient, Graph::negate),
                    hessian: self.each(inner.hessian, Graph::negate),
                }
            }
            Kind::Chain(first, operands) => self.chain(first, operands),
            Kind::Power(sides) => {
                let [base, exponent] = sides.as_ref();
                let power = if is_root(exponent) { self.below_root(base) } else { self.node(base) };
                let raised = self.node(exponent);
                if exponent.varies() {
                    self.varying_power(power, raised)
                } else {
                    self.fixed_power(power, raised.value)
                }
            }
            Kind::Call(function, argument) => {
                let is_sided = self.sides.as_ref().is_some_and(|sides| sides.take(argument));
                let is_root = *function == Function::Sqrt;
                let inner = if is_root { self.below_root(argument) } else { self.node(argument) };
                match function {
                    Function::Step | Function::Sign | Function::Abs if is_sided => {
                        self.sided_function(*function, node, inner)
                    }
                    _ => self.function(*function, inner),
                }
            }
            Kind::Choice(function, sides) => {
                let [left, right] = sides.as_ref();
                let (left, right) = (self.node(left), self.node(right));
                match function.selects() && self.sides.as_ref().is_some_and(|sides| sides.take(node)) {
                    true => self.sided_choice(*function, node, &left, &right),
                    false => self.choice(*function, left, right),
                }
            }
        }
    }

    /// What a root is taken of. An absolute value there is no kink whose sides are inputs: a root has no
    /// smooth continuation to the other side, where it would be that of a negative number.
    fn below_root(&mut self, node: &Node) -> Derivatives {
        let Kind::Call(Function::Abs, argument) = node.kind() else { return self.node(node) };
        let inner = self.node(argument);
        self.function(Function::Abs, inner)
    }

    /// A factor of a product. With a root of |g| as another factor sign(g) is no jump.
    fn factor(&mut self, node: &Node, below_roots: &[Value]) -> Derivatives {
        match node.kind() {
            _ if below_roots.is_empty() => self.node(node),
            Kind::Negation(inner) => {
                let inner = self.factor(inner, below_roots);
                Derivatives {
                    value: self.graph.negate(inner.value),
                    gradient: self.each(inner.gradient, Graph::negate),
                    hessian: self.each(inner.hessian, Graph::negate),
                }
            }
            Kind::Call(Function::Sign, argument) => {
                // Equal parts are one value.
                let inner = self.node(argument);
                let is_below = below_roots.contains(&inner.value);
                if is_below { self.function(Function::Sign, inner) } else { self.node(node) }
            }
            _ => self.node(node),
        }
    }

    fn each<K>(
        &mut self,
        entries: Vec<(K, Value)>,
        mut change: impl FnMut(&mut Graph, Value) -> Value,
    ) -> Vec<(K, Value)> {
        entries.into_iter().map(|(key, value)| (key, change(self.graph, value))).collect()
    }

    /// A sum or product, evaluated from left to right.
    fn chain(&mut self, first: &Node, operands: &[(Operator, Node)]) -> Derivatives {
        if !operands.iter().any(|(operator, _)| operator.is_additive()) {
            let factors = operands.iter().filter(|(operator, _)| *operator == Operator::Multiply);
            let factors = std::iter::once(first).chain(factors.map(|(_, factor)| factor));
            let below_roots: Vec<Value> =
                factors.filter_map(size_below_root).map(|argument| self.node(argument).value).collect();
            let mut joined = self.factor(first, &below_roots);
            for (operator, operand) in operands {
                let operand = self.factor(operand, &below_roots);
                joined = match operator {
                    Operator::Divide => self.quotient(joined, &operand),
                    _ => self.product(joined, &operand),
                };
            }
            return joined;
        }
        // The derivatives of all terms are collected first: adding them term by term would copy them each
        // time.
        let Derivatives { mut value, mut gradient, mut hessian } = self.node(first);
        for (operator, operand) in operands {
            let mut term = self.node(operand);
            if *operator == Operator::Subtract {
                value = self.graph.subtract(value, term.value);
                term.gradient = self.each(term.gradient, Graph::negate);
                term.hessian = self.each(term.hessian, Graph::negate);
            } else {
                value = self.graph.add(value, term.value);
            }
            gradient.extend(term.gradient);
            hessian.extend(term.hessian);
        }
        Derivatives { value, gradient: self.gathered(gradient), hessian: self.gathered(hessian) }
    }

    /// Adds entries at the same place in their order; places are ascending in the result, and zeros are left
    /// out.
    fn gathered<K: Ord + Copy>(&mut self, mut entries: Vec<(K, Value)>) -> Vec<(K, Value)> {
        entries.sort_by_key(|&(key, _)| key);
        let mut sums: Vec<(K, Value)> = Vec::with_capacity(entries.len());
        for (key, value) in entries {
            match sums.last_mut() {
                Some((last, sum)) if *last == key => *sum = self.graph.add(*sum, value),
                _ => sums.push((key, value)),
            }
        }
        sums.retain(|&(_, sum)| !self.is_zero(sum));
        sums
    }

    /// True if the entry of the Hessian in row i and column j ≤ i is computed.
    fn asks(&self, i: u32, j: u32) -> bool {
        self.along.is_none() || (i == ALONG && j != ALONG)
    }

    /// x_i·y_j + x_j·y_i for i ≥ j.
    fn cross(&mut self, x: &[(u32, Value)], y: &[(u32, Value)]) -> Vec<(Entry, Value)> {
        if self.order < Order::Hessian {
            return Vec::new();
        }
        let mut entries = Vec::new();
        for &(i, x) in x {
            for &(j, y) in y {
                if !self.asks(i.max(j), i.min(j)) {
                    continue;
                }
                let product = self.graph.multiply(x, y);
                let entry = if i == j { self.graph.add(product, product) } else { product };
                entries.push(((i.max(j), i.min(j)), entry));
            }
        }
        self.gathered(entries)
    }

    fn product(&mut self, x: Derivatives, y: &Derivatives) -> Derivatives {
        let value = self.graph.multiply(x.value, y.value);
        let cross = self.cross(&x.gradient, &y.gradient);
        let mut gradient = self.each(x.gradient, |graph, slope| graph.multiply(slope, y.value));
        gradient.extend(self.each(y.gradient.clone(), |graph, slope| graph.multiply(slope, x.value)));
        let mut hessian = self.each(x.hessian, |graph, entry| graph.multiply(entry, y.value));
        hessian.extend(self.each(y.hessian.clone(), |graph, entry| graph.multiply(entry, x.value)));
        hessian.extend(cross);
        Derivatives { value, gradient: self.gathered(gradient), hessian: self.gathered(hessian) }
    }

    /// From f = rg: r′ = (f′ − rg′)/g and r″ = (f″ − rg″ − r′g′ᵀ − g′r′ᵀ)/g.
    fn quotient(&mut self, x: Derivatives, y: &Derivatives) -> Derivatives {
        let value = self.graph.divide(x.value, y.value);
        let mut gradient = x.gradient;
        gradient.extend(self.each(y.gradient.clone(), |graph, slope| {
            let known = graph.multiply(slope, value);
            graph.negate(known)
        }));
        let gradient = self.gathered(gradient);
        let gradient = self.each(gradient, |graph, slope| graph.divide(slope, y.value));
        let mut hessian = x.hessian;
        hessian.extend(self.each(y.hessian.clone(), |graph, entry| {
            let known = graph.multiply(entry, value);
            graph.negate(known)
        }));
        let cross = self.cross(&gradient, &y.gradient);
        hessian.extend(self.each(cross, Graph::negate));
        let hessian = self.gathered(hessian);
        let hessian = self.each(hessian, |graph, entry| graph.divide(entry, y.value));
        Derivatives { value, gradient, hessian }
    }

    /// f(x), given the values of f, f′ and f″; `None` if the second derivative is identically zero.
    fn outer(&mut self, x: Derivatives, value: Value, first: Value, second: Option<Value>) -> Derivatives {
        let mut hessian = self.each(x.hessian, |graph, entry| graph.scale(first, entry));
        if let Some(second) = second
            && !self.is_zero(second)
        {
            hessian.extend(self.squares(&x.gradient, second));
        }
        let hessian = self.gathered(hessian);
        let gradient = self.each(x.gradient, |graph, slope| graph.scale(first, slope));
        Derivatives { value, gradient, hessian }
    }

    fn is_zero(&self, value: Value) -> bool {
        self.graph.number(value) == Some(0.0)
    }

    /// factor·x_i·x_j for i ≥ j.
    fn squares(&mut self, x: &[(u32, Value)], factor: Value) -> Vec<(Entry, Value)> {
        if self.order < Order::Hessian {
            return Vec::new();
        }
        let mut entries = Vec::new();
        for (count, &(i, row)) in x.iter().enumerate() {
            for &(j, column) in &x[..=count] {
                if !self.asks(i, j) {
                    continue;
                }
                let square = self.graph.multiply(row, column);
                entries.push(((i, j), self.graph.scale(factor, square)));
            }
        }
        entries
    }

    /// x^e with an exponent without variables: x^e, e·x^(e−1), e(e−1)·x^(e−2), a factor 0 winning over x = 0.
    fn fixed_power(&mut self, x: Derivatives, exponent: Value) -> Derivatives {
        let value = self.graph.power(x.value, exponent);
        if x.gradient.is_empty() || self.is_zero(exponent) {
            return Derivatives::constant(value);
        }
        let one = self.graph.constant(1.0);
        let reduced = self.graph.subtract(exponent, one);
        let power = self.graph.power(x.value, reduced);
        let first = self.graph.scale(power, exponent);
        let factor = self.graph.multiply(exponent, reduced);
        let second = if self.is_zero(factor) {
            None
        } else {
            let twice_reduced = self.graph.subtract(reduced, one);
            let power = self.graph.power(x.value, twice_reduced);
            Some(self.graph.scale(power, factor))
        };
        self.outer(x, value, first, second)
    }

    /// b^e with a variable exponent: e^(e·ln b), with derivatives 0 where it is 0.
    fn varying_power(&mut self, base: Derivatives, exponent: Derivatives) -> Derivatives {
        let value = self.graph.power(base.value, exponent.value);
        if base.gradient.is_empty() && exponent.gradient.is_empty() {
            return Derivatives::constant(value);
        }
        let logarithm = self.function(Function::Log, base);
        let mut inner = self.product(exponent, &logarithm);
        // sign(b^e) in absolute value is 0 or 1: ln b is infinite where b^e is 0.
        let sign = self.graph.call(Operation::Call(Function::Sign), value);
        let present = self.graph.call(Operation::Call(Function::Abs), sign);
        inner.gradient = self.each(inner.gradient, |graph, slope| graph.scale(slope, present));
        inner.hessian = self.each(inner.hessian, |graph, entry| graph.scale(entry, present));
        self.outer(inner, value, value, Some(value))
    }

    /// Derivatives at a kink or jump are those of neither side: `abs` has 0 at 0, `step` and `sign` 0
    /// everywhere.
    fn function(&mut self, function: Function, x: Derivatives) -> Derivatives {
        let v = x.value;
        let call = |graph: &mut Graph, function| graph.call(Operation::Call(function), v);
        let value = call(self.graph, function);
        if x.gradient.is_empty() || matches!(function, Function::Step | Function::Sign) {
            return Derivatives::constant(value);
        }
        let (one, two) = (self.graph.constant(1.0), self.graph.constant(2.0));
        let (first, second) = match function {
            Function::Step
            | Function::Sign
            | Function::Min
            | Function::Max
            | Function::Atan2
            | Function::Hypot => return Derivatives::constant(value),
            Function::Abs => (call(self.graph, Function::Sign), None),
            Function::Sqrt => {
                let twice = self.graph.multiply(two, value);
                let slope = self.graph.divide(one, twice);
                let twice = self.graph.multiply(two, v);
                let change = self.graph.divide(slope, twice);
                (slope, Some(self.graph.negate(change)))
            }
            Function::Exp => (value, Some(value)),
            Function::Log => {
                let square = self.graph.multiply(v, v);
                let change = self.graph.divide(one, square);
                (self.graph.divide(one, v), Some(self.graph.negate(change)))
            }
            Function::Sin => (call(self.graph, Function::Cos), Some(self.graph.negate(value))),
            Function::Cos => {
                let sine = call(self.graph, Function::Sin);
                (self.graph.negate(sine), Some(self.graph.negate(value)))
            }
            Function::Tan => {
                let square = self.graph.multiply(value, value);
                let slope = self.graph.add(one, square);
                let twice = self.graph.multiply(two, value);
                (slope, Some(self.graph.multiply(twice, slope)))
            }
            Function::Atan => {
                let square = self.graph.multiply(v, v);
                let sum = self.graph.add(one, square);
                let slope = self.graph.divide(one, sum);
                let twice = self.graph.multiply(two, v);
                let negative = self.graph.negate(twice);
                let change = self.graph.multiply(negative, slope);
                (slope, Some(self.graph.multiply(change, slope)))
            }
            Function::Asin | Function::Acos => {
                let (below, above) = (self.graph.subtract(one, v), self.graph.add(one, v));
                let square = self.graph.multiply(below, above);
                let root = self.graph.call(Operation::Call(Function::Sqrt), square);
                let slope = self.graph.divide(one, root);
                let change = self.graph.multiply(v, slope);
                let change = self.graph.divide(change, square);
                match function {
                    Function::Asin => (slope, Some(change)),
                    _ => (self.graph.negate(slope), Some(self.graph.negate(change))),
                }
            }
            Function::Sinh => (call(self.graph, Function::Cosh), Some(value)),
            Function::Cosh => (call(self.graph, Function::Sinh), Some(value)),
            Function::Tanh => {
                // 1/cosh² is accurate where 1 − tanh² has cancelled.
                let cosine = call(self.graph, Function::Cosh);
                let square = self.graph.multiply(cosine, cosine);
                let slope = self.graph.divide(one, square);
                let twice = self.graph.multiply(two, value);
                let change = self.graph.multiply(twice, slope);
                (slope, Some(self.graph.negate(change)))
            }
            Function::Gamma => {
                // Γ′ = Γψ, Γ″ = Γ(ψ² + ψ′).
                let digamma = self.graph.call(Operation::Digamma, v);
                let trigamma = self.graph.call(Operation::Trigamma, v);
                let square = self.graph.multiply(digamma, digamma);
                let sum = self.graph.add(square, trigamma);
                (self.graph.multiply(value, digamma), Some(self.graph.multiply(value, sum)))
            }
        };
        self.outer(x, value, first, second)
    }

    /// The side of a jump or kink, σ = a + b g with the argument g and two inputs a and b, which are 1 and 0
    /// above, 0 and 0 below. `None` if sides are not inputs.
    fn side(&mut self, node: &Node, argument: &Derivatives) -> Option<Derivatives> {
        let [offset, slope] = self.sides.as_mut()?.inputs(node, (argument.value, &argument.gradient));
        let (offset, slope) = (self.graph.insert(offset), self.graph.insert(slope));
        let part = self.graph.scale(argument.value, slope);
        Some(Derivatives {
            value: self.graph.add(offset, part),
            gradient: self.each(argument.gradient.clone(), |graph, x| graph.scale(x, slope)),
            hessian: self.each(argument.hessian.clone(), |graph, x| graph.scale(x, slope)),
        })
    }

    /// `step`, `sign` and `abs` on the side of the inputs: σ, 2σ − 1 and (2σ − 1) g.
    fn sided_function(&mut self, function: Function, node: &Node, x: Derivatives) -> Derivatives {
        let Some(side) = self.side(node, &x) else { return self.function(function, x) };
        if function == Function::Step {
            return side;
        }
        let (one, two) = (self.graph.constant(1.0), self.graph.constant(2.0));
        let twice = self.graph.multiply(two, side.value);
        let sign = Derivatives {
            value: self.graph.subtract(twice, one),
            gradient: self.each(side.gradient, |graph, x| graph.multiply(two, x)),
            hessian: self.each(side.hessian, |graph, x| graph.multiply(two, x)),
        };
        if function == Function::Sign { sign } else { self.product(sign, &x) }
    }

    /// `min` and `max` on the side of the inputs, with g = left − right: σ u + (1 − σ) l, where u is the
    /// result above. The other side may have any value.
    fn sided_choice(
        &mut self,
        function: Function,
        node: &Node,
        left: &Derivatives,
        right: &Derivatives,
    ) -> Derivatives {
        let negative = |differentiation: &mut Self, x: &Derivatives| Derivatives {
            value: differentiation.graph.negate(x.value),
            gradient: differentiation.each(x.gradient.clone(), Graph::negate),
            hessian: differentiation.each(x.hessian.clone(), Graph::negate),
        };
        let opposite = negative(self, right);
        let argument = self.sum(left, &opposite);
        let Some(side) = self.side(node, &argument) else {
            return self.choice(function, left.clone(), right.clone());
        };
        let one = self.graph.constant(1.0);
        let other = negative(self, &side);
        let other = Derivatives { value: self.graph.subtract(one, side.value), ..other };
        let (above, below) = if function == Function::Max { (left, right) } else { (right, left) };
        let above = self.share(above, &side);
        let below = self.share(below, &other);
        self.sum(&above, &below)
    }

    /// σ x, and 0 for σ = 0 and any x.
    fn share(&mut self, x: &Derivatives, side: &Derivatives) -> Derivatives {
        let scaled = |graph: &mut Graph, entry| graph.scale(entry, side.value);
        let value = self.graph.scale(x.value, side.value);
        let cross = self.cross(&x.gradient, &side.gradient);
        let mut gradient = self.each(x.gradient.clone(), scaled);
        gradient.extend(self.each(side.gradient.clone(), |graph, slope| graph.scale(x.value, slope)));
        let mut hessian = self.each(x.hessian.clone(), scaled);
        hessian.extend(self.each(side.hessian.clone(), |graph, entry| graph.scale(x.value, entry)));
        hessian.extend(cross);
        Derivatives { value, gradient: self.gathered(gradient), hessian: self.gathered(hessian) }
    }

    fn sum(&mut self, x: &Derivatives, y: &Derivatives) -> Derivatives {
        let join = |x: &[(u32, Value)], y: &[(u32, Value)]| [x, y].concat();
        let (gradient, hessian) =
            (join(&x.gradient, &y.gradient), x.hessian.iter().chain(&y.hessian).copied().collect());
        Derivatives {
            value: self.graph.add(x.value, y.value),
            gradient: self.gathered(gradient),
            hessian: self.gathered(hessian),
        }
    }

    /// The selected one of two values, with its derivatives.
    fn choice(&mut self, function: Function, left: Derivatives, right: Derivatives) -> Derivatives {
        match function {
            Function::Atan2 => return self.angle(&left, &right),
            Function::Hypot => {
                let squares = [self.product(left.clone(), &left), self.product(right.clone(), &right)];
                let sum = self.sum(&squares[0], &squares[1]);
                return self.function(Function::Sqrt, sum);
            }
            _ => {}
        }
        let comparison = if function == Function::Min { Operation::LeftIsMin } else { Operation::LeftIsMax };
        let choice = self.graph.compare(comparison, left.value, right.value);
        Derivatives {
            value: self.graph.pick(choice, left.value, right.value),
            gradient: self.either(choice, &left.gradient, &right.gradient),
            hessian: self.either(choice, &left.hessian, &right.hessian),
        }
    }

    /// The angle of the point (y, x): in axes turned by it, its derivatives are those of the tangent there.
    fn angle(&mut self, y: &Derivatives, x: &Derivatives) -> Derivatives {
        let scaled = |all: &mut Self, of: &Derivatives, by: Value| Derivatives {
            value: all.graph.multiply(of.value, by),
            gradient: all.each(of.gradient.clone(), |graph, slope| graph.multiply(slope, by)),
            hessian: all.each(of.hessian.clone(), |graph, entry| graph.multiply(entry, by)),
        };
        let (along, beside) = (scaled(self, x, x.value), scaled(self, y, y.value));
        let along = self.sum(&along, &beside);
        let negative = self.graph.negate(y.value);
        let (ahead, back) = (scaled(self, y, x.value), scaled(self, x, negative));
        let across = self.sum(&ahead, &back);
        let turned = self.quotient(across, &along);
        Derivatives { value: self.graph.compare(Operation::Angle, y.value, x.value), ..turned }
    }

    fn either<K: Ord + Copy>(
        &mut self,
        choice: Value,
        left: &[(K, Value)],
        right: &[(K, Value)],
    ) -> Vec<(K, Value)> {
        let zero = self.graph.constant(0.0);
        let find = |entries: &[(K, Value)], key| match entries.binary_search_by_key(&key, |&(key, _)| key) {
            Ok(place) => entries[place].1,
            Err(_) => zero,
        };
        let mut keys: Vec<K> = left.iter().chain(right).map(|&(key, _)| key).collect();
        keys.sort();
        keys.dedup();
        keys.into_iter()
            .map(|key| (key, self.graph.pick(choice, find(left, key), find(right, key))))
            .collect()
    }
}
