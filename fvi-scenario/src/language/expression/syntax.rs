//! The parser of expressions, with errors that state the fault and its place.

use super::Symbols;
use super::function::Function;
use super::tree::{Node, Operator};
use crate::language::excerpt::{excerpt, excerpt_list};
use core::ops::Range;

/// Deepest nesting that is accepted: evaluation is recursive. A sum or product counts once, however many
/// terms it has.
const MAX_DEPTH: usize = 128;

/// Error of an expression: the fault, and the bytes of its text that cause it.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{fault} (column {})", self.column())]
pub struct ExpressionError {
    /// The problem.
    pub fault: ExpressionFault,
    /// The bytes of the text that cause the fault; empty at the end of the text.
    pub span: Range<usize>,
    column: usize,
}

impl ExpressionError {
    /// Column of the first of these characters, counted from 1 in characters.
    pub fn column(&self) -> usize {
        self.column
    }

    /// Allowed alternatives, if they can be stated.
    pub fn advice(&self) -> Option<String> {
        match &self.fault {
            ExpressionFault::UnknownName { suggestion: Some(near), allowed, .. } => {
                Some(format!("did you mean `{near}`? Known here: {allowed}"))
            }
            ExpressionFault::UnknownName { suggestion: None, allowed, .. } => {
                Some(format!("known here: {allowed}"))
            }
            ExpressionFault::UnknownFunction { suggestion, .. } => {
                let near = suggestion.map(|near| format!("did you mean `{near}`? ")).unwrap_or_default();
                Some(format!("{near}Functions: {}", Function::names().collect::<Vec<_>>().join(", ")))
            }
            ExpressionFault::UnexpectedCharacter { character: '*' } => {
                Some("powers are written with ^".to_owned())
            }
            ExpressionFault::MissingOperator => Some("products are written with *".to_owned()),
            _ => None,
        }
    }
}

/// Problem with an expression.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ExpressionFault {
    /// The text is empty.
    #[error("the expression is empty")]
    Empty,
    /// A character that is not allowed at this place.
    #[error("unexpected character `{}`", excerpt(&character.to_string()))]
    UnexpectedCharacter {
        /// The character.
        character: char,
    },
    /// Digits that do not form a number.
    #[error("`{text}` is not a number")]
    BadNumber {
        /// The digits.
        text: String,
    },
    /// A name that is not defined.
    #[error("unknown name `{name}`")]
    UnknownName {
        /// The name.
        name: String,
        /// The most similar known name, if there is a similar one.
        suggestion: Option<String>,
        /// The known names, separated by commas; of many variables only some.
        allowed: String,
    },
    /// A name in front of a bracket that is not a function.
    #[error("unknown function `{name}`")]
    UnknownFunction {
        /// The name.
        name: String,
        /// The most similar function, if there is a similar one.
        suggestion: Option<&'static str>,
    },
    /// A function without its bracket.
    #[error("the function `{name}` needs its argument in brackets")]
    MissingArgument {
        /// The function.
        name: String,
    },
    /// Too few or too many arguments.
    #[error("the function `{name}` takes {expected} argument(s), not {found}")]
    ArgumentCount {
        /// The function.
        name: String,
        /// Number of arguments that it takes.
        expected: usize,
        /// Number of arguments found.
        found: usize,
    },
    /// An opening bracket that is never closed.
    #[error("this bracket is never closed")]
    Unclosed,
    /// A closing bracket that was never opened.
    #[error("this bracket was never opened")]
    Unopened,
    /// Two operands side by side.
    #[error("an operator is missing here")]
    MissingOperator,
    /// An operator without its operand.
    #[error("a number, a name or an opening bracket is missing here")]
    MissingOperand,
    /// A constant part whose value is infinite or not a number.
    #[error("this part is {value}, not a finite number")]
    NotFinite {
        /// Its value.
        value: f64,
    },
    /// Nested too deeply to be evaluated safely.
    #[error("the expression is nested more than {MAX_DEPTH} deep")]
    TooDeep,
}

/// True if a name can begin with the character.
pub(super) fn starts_name(letter: char) -> bool {
    letter.is_alphabetic() || letter == '_'
}

/// True if a name can continue with the character.
pub(super) fn continues_name(letter: char) -> bool {
    letter.is_alphanumeric() || letter == '_'
}

#[derive(Clone, Debug, PartialEq)]
enum Token {
    Number(f64),
    Name,
    Symbol(char),
}

/// A part of the tree with the bytes it came from and its depth.
struct Part {
    node: Node,
    start: usize,
    end: usize,
    depth: usize,
}

type Parsed<T> = Result<T, (ExpressionFault, Range<usize>)>;

/// Parses `text` into a tree with all constants folded.
pub(super) fn parse(text: &str, symbols: &Symbols) -> Result<Node, ExpressionError> {
    parse_root(text, symbols).map_err(|(fault, span)| {
        let column = text[..span.start].chars().count() + 1;
        ExpressionError { fault, span, column }
    })
}

fn parse_root(text: &str, symbols: &Symbols) -> Parsed<Node> {
    let tokens = tokens(text)?;
    if tokens.is_empty() {
        return Err((ExpressionFault::Empty, 0..text.len()));
    }
    let mut parser = Parser { text, symbols, tokens, next: 0, nesting: 0 };
    let part = parser.sum()?;
    match parser.peek() {
        None => Ok(part.node),
        Some((Token::Symbol(')'), span)) => Err((ExpressionFault::Unopened, span)),
        Some((Token::Symbol(character), span)) => {
            Err((ExpressionFault::UnexpectedCharacter { character }, span))
        }
        Some((_, span)) => Err((ExpressionFault::MissingOperator, span)),
    }
}

fn tokens(text: &str) -> Parsed<Vec<(Token, Range<usize>)>> {
    let mut tokens = Vec::new();
    let mut start = 0;
    while let Some(letter) = text[start..].chars().next() {
        let rest = &text[start..];
        let length = if letter.is_whitespace() {
            letter.len_utf8()
        } else if letter.is_ascii_digit() || letter == '.' {
            let length = number_length(rest);
            let digits = &rest[..length];
            match digits.parse::<f64>() {
                Ok(value) if value.is_finite() => tokens.push((Token::Number(value), start..start + length)),
                _ => {
                    let fault = ExpressionFault::BadNumber { text: excerpt(digits) };
                    return Err((fault, start..start + length));
                }
            }
            length
        } else if starts_name(letter) {
            let length = rest.find(|next| !continues_name(next)).unwrap_or(rest.len());
            tokens.push((Token::Name, start..start + length));
            length
        } else if "+-*/^(),".contains(letter) {
            tokens.push((Token::Symbol(letter), start..start + 1));
            1
        } else {
            let fault = ExpressionFault::UnexpectedCharacter { character: letter };
            return Err((fault, start..start + letter.len_utf8()));
        };
        start += length;
    }
    Ok(tokens)
}

/// Length of the number at the beginning: digits, point, digits, and an exponent if it has digits.
fn number_length(text: &str) -> usize {
    let digits = |from: usize| text[from..].bytes().take_while(u8::is_ascii_digit).count();
    let mut length = digits(0);
    if text[length..].starts_with('.') {
        length += 1;
        length += digits(length);
    }
    if text[length..].starts_with(['e', 'E']) {
        let sign = usize::from(text[length + 1..].starts_with(['+', '-']));
        let exponent = digits(length + 1 + sign);
        if exponent > 0 {
            length += 1 + sign + exponent;
        }
    }
    length
}

struct Parser<'a> {
    text: &'a str,
    symbols: &'a Symbols,
    tokens: Vec<(Token, Range<usize>)>,
    next: usize,
    nesting: usize,
}

impl Parser<'_> {
    fn peek(&self) -> Option<(Token, Range<usize>)> {
        self.tokens.get(self.next).cloned()
    }

    fn take_symbol(&mut self, wanted: &[char]) -> Option<(char, Range<usize>)> {
        match self.peek() {
            Some((Token::Symbol(symbol), span)) if wanted.contains(&symbol) => {
                self.next += 1;
                Some((symbol, span))
            }
            _ => None,
        }
    }

    /// Checks a new part: its constants are finite and it is not nested too deeply.
    fn part(&self, node: Node, span: Range<usize>, depth: usize) -> Parsed<Part> {
        if let Some(value) = node.as_number()
            && !value.is_finite()
        {
            return Err((ExpressionFault::NotFinite { value }, span));
        }
        if depth > MAX_DEPTH {
            return Err((ExpressionFault::TooDeep, span));
        }
        Ok(Part { node, start: span.start, end: span.end, depth })
    }

    fn join(&self, operator: Operator, left: Part, right: Part) -> Parsed<Part> {
        let grows = !left.node.takes(operator, &right.node);
        let depth = (left.depth + usize::from(grows)).max(right.depth + 1);
        self.part(Node::join(operator, left.node, right.node), left.start..right.end, depth)
    }

    fn sum(&mut self) -> Parsed<Part> {
        // Brackets recurse through here: the parser must not overflow the stack either.
        self.nesting += 1;
        if self.nesting > MAX_DEPTH {
            let span = self.peek().map_or(self.text.len()..self.text.len(), |(_, span)| span);
            return Err((ExpressionFault::TooDeep, span));
        }
        let mut left = self.product()?;
        while let Some((symbol, _)) = self.take_symbol(&['+', '-']) {
            let right = self.product()?;
            let operator = if symbol == '+' { Operator::Add } else { Operator::Subtract };
            left = self.join(operator, left, right)?;
        }
        self.nesting -= 1;
        Ok(left)
    }

    fn product(&mut self) -> Parsed<Part> {
        let mut left = self.signed()?;
        while let Some((symbol, _)) = self.take_symbol(&['*', '/']) {
            let right = self.signed()?;
            let operator = if symbol == '*' { Operator::Multiply } else { Operator::Divide };
            left = self.join(operator, left, right)?;
        }
        Ok(left)
    }

    fn signed(&mut self) -> Parsed<Part> {
        let Some((mut symbol, Range { start, .. })) = self.take_symbol(&['+', '-']) else {
            return self.power();
        };
        let mut negative = symbol == '-';
        while let Some((next, _)) = self.take_symbol(&['+', '-']) {
            symbol = next;
            negative ^= symbol == '-';
        }
        let inner = self.power()?;
        if negative {
            self.part(Node::negation(inner.node), start..inner.end, inner.depth + 1)
        } else {
            Ok(Part { start, ..inner })
        }
    }

    fn power(&mut self) -> Parsed<Part> {
        let base = self.primary()?;
        if self.take_symbol(&['^']).is_none() {
            return Ok(base);
        }
        self.nesting += 1;
        if self.nesting > MAX_DEPTH {
            return Err((ExpressionFault::TooDeep, base.start..base.end));
        }
        let exponent = self.signed()?;
        self.nesting -= 1;
        let depth = 1 + base.depth.max(exponent.depth);
        self.part(Node::power(base.node, exponent.node), base.start..exponent.end, depth)
    }

    fn primary(&mut self) -> Parsed<Part> {
        let Some((token, span)) = self.peek() else {
            return Err((ExpressionFault::MissingOperand, self.text.len()..self.text.len()));
        };
        self.next += 1;
        match token {
            Token::Number(value) => self.part(Node::number(value), span, 1),
            Token::Name => self.named(span),
            Token::Symbol('(') => {
                let inner = self.sum()?;
                let end = self.close(span.clone())?;
                Ok(Part { start: span.start, end, ..inner })
            }
            Token::Symbol(')') if self.nesting <= 1 => Err((ExpressionFault::Unopened, span)),
            Token::Symbol('*') => Err((ExpressionFault::UnexpectedCharacter { character: '*' }, span)),
            Token::Symbol(_) => Err((ExpressionFault::MissingOperand, span)),
        }
    }

    /// Takes the closing bracket that belongs to `opening`.
    fn close(&mut self, opening: Range<usize>) -> Parsed<usize> {
        if let Some((_, span)) = self.take_symbol(&[')']) {
            return Ok(span.end);
        }
        match self.peek() {
            None => Err((ExpressionFault::Unclosed, opening)),
            Some((Token::Symbol(character), span)) => {
                Err((ExpressionFault::UnexpectedCharacter { character }, span))
            }
            Some((_, span)) => Err((ExpressionFault::MissingOperator, span)),
        }
    }

    fn named(&mut self, span: Range<usize>) -> Parsed<Part> {
        let name = &self.text[span.clone()];
        let called = self.take_symbol(&['(']);
        let function = Function::named(name);
        match (function, called) {
            (Some(function), Some((_, opening))) => self.call(function, span, opening),
            (Some(_), None) => Err((ExpressionFault::MissingArgument { name: excerpt(name) }, span)),
            (None, called) => match self.symbols.resolve(name) {
                // A known name before a bracket: the multiplication sign is missing.
                Some(_) if called.is_some() => {
                    Err((ExpressionFault::MissingOperator, span.end..span.end + 1))
                }
                Some(node) => self.part(node, span, 1),
                None if called.is_some() => {
                    let suggestion = nearest(name, Function::names());
                    Err((ExpressionFault::UnknownFunction { name: excerpt(name), suggestion }, span))
                }
                None => {
                    let fault = ExpressionFault::UnknownName {
                        name: excerpt(name),
                        suggestion: nearest(name, self.symbols.names()).map(str::to_owned),
                        allowed: excerpt_list(&self.symbols.names_in_brief()),
                    };
                    Err((fault, span))
                }
            },
        }
    }

    fn call(&mut self, function: Function, span: Range<usize>, opening: Range<usize>) -> Parsed<Part> {
        let mut arguments = vec![self.sum()?];
        while self.take_symbol(&[',']).is_some() {
            arguments.push(self.sum()?);
        }
        let end = self.close(opening)?;
        let span = span.start..end;
        let depth = 1 + arguments.iter().map(|argument| argument.depth).max().unwrap_or(0);
        let found = arguments.len();
        let mut arguments = arguments.into_iter().map(|argument| argument.node);
        let node = match (function.arguments(), arguments.next(), arguments.next(), arguments.next()) {
            (1, Some(argument), None, _) => Node::call(function, argument),
            (2, Some(left), Some(right), None) => Node::choice(function, left, right),
            (expected, ..) => {
                let name = self.text[span.clone()].split('(').next().unwrap_or_default().trim().to_owned();
                return Err((ExpressionFault::ArgumentCount { name, expected, found }, span));
            }
        };
        self.part(node, span, depth)
    }
}

/// The candidate most similar to `name`, if one is similar enough.
pub fn nearest<'a>(name: &str, candidates: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    let letters = name.chars().count();
    candidates
        .filter_map(|candidate| {
            let length = candidate.chars().count();
            let most = 1 + length / 4;
            // The edit distance is at least the difference of the lengths: the search, quadratic in the
            // length, is skipped.
            if letters.abs_diff(length) > most {
                return None;
            }
            let distance = strsim::damerau_levenshtein(&name.to_lowercase(), &candidate.to_lowercase());
            (distance <= most).then_some((distance, candidate))
        })
        // Of two that are as near `x0` is meant by `x`, rather than `t`.
        .min_by_key(|&(distance, candidate)| (distance, !candidate.starts_with(name)))
        .map(|(_, candidate)| candidate)
}
