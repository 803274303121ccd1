//! Rewrites sources so that one program holds all mutants, of which an environment variable chooses one.
//!
//! `a + b` becomes
//! `match (a, b) { (x, y) => if original { x + y } else if … { x - y } else { x * y } }`: operands are
//! evaluated once and in their order, so that sites nest without growing. Where code that runs names a
//! constant of its module that has mutants, it calls a function instead, which chooses one of several
//! constants. All else that the compiler computes, such as lengths of arrays, stays as it is.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};

use proc_macro2::{Span, TokenTree};
use syn::spanned::Spanned;
use syn::visit::{self, Visit};
use syn::{BinOp, Expr, UnOp};

use crate::mutant::{LineColumn, Mutant};

/// Where code is rewritten, by bytes.
struct Site {
    /// Empty where something is put in between.
    range: Range<usize>,
    kind: Kind,
    /// Positions of its mutants in the list.
    mutants: Vec<usize>,
}

enum Kind {
    Body,
    Arm,
    Guard,
    Unary {
        operator: String,
        operand: Range<usize>,
    },
    Binary {
        left: Range<usize>,
        operator: String,
        right: Range<usize>,
    },
    /// A structure, of which mutants leave out a field.
    Fields,
    /// The whole body of a function that returns an iterator without a name, which mutants make empty.
    Emptied,
    /// Behind a constant: the function that chooses.
    Constant {
        name: String,
        of_type: Range<usize>,
        value: Range<usize>,
    },
    /// Where its name stands.
    Named(String),
}

impl Kind {
    /// Of sites that begin together, the outermost comes first.
    fn rank(&self) -> u8 {
        match self {
            Self::Body | Self::Arm => 0,
            Self::Guard => 1,
            Self::Unary { .. } | Self::Binary { .. } | Self::Fields => 2,
            Self::Emptied | Self::Constant { .. } | Self::Named(_) => 3,
        }
    }
}

/// A constant of a module with mutants, and where it is named in code that runs.
struct Constant {
    site: Site,
    name: String,
    named: Vec<Range<usize>>,
}

struct Finder<'m> {
    mutants: &'m [Mutant],
    wanted: HashMap<(&'m str, LineColumn), Vec<usize>>,
    sites: Vec<Site>,
    constants: Vec<Constant>,
}

/// Is the result one that `return` cannot replace, its type having no name?
fn opaque(mutant: &Mutant) -> bool {
    mutant.genre == "FnValue" && mutant.returns.contains("impl ")
}

fn place(span: Span) -> LineColumn {
    (span.start().line, span.start().column + 1)
}

impl<'m> Finder<'m> {
    fn add(&mut self, genre: &'m str, at: Span, range: Range<usize>, kind: Kind) {
        if let Some(mutants) = self.wanted.remove(&(genre, place(at))) {
            self.sites.push(Site { range, kind, mutants });
        }
    }

    fn body(&mut self, block: &syn::Block) {
        if let Some(first) = block.stmts.first() {
            let Range { start, .. } = first.span().byte_range();
            let end = block.stmts.last().map_or(start, |last| last.span().byte_range().end);
            let wanted = self.wanted.get(&("FnValue", place(first.span())));
            if wanted.is_some_and(|wanted| wanted.iter().any(|&at| opaque(&self.mutants[at]))) {
                self.add("FnValue", first.span(), start..end, Kind::Emptied);
            } else {
                self.add("FnValue", first.span(), start..start, Kind::Body);
            }
        }
    }

    /// The constants that nobody outside of their file can name, with the mutants of their values.
    fn constants(&mut self, items: &[syn::Item]) {
        for item in items {
            let syn::Item::Const(item) = item else { continue };
            let (span, end) = (item.expr.span(), item.span().byte_range().end);
            let within = |at: &LineColumn| {
                (span.start().line, span.start().column) < *at && *at <= (span.end().line, span.end().column)
            };
            let keys: Vec<_> = self.wanted.keys().filter(|(_, at)| within(at)).copied().collect();
            if keys.is_empty() || !matches!(item.vis, syn::Visibility::Inherited) {
                continue;
            }
            let mut mutants: Vec<usize> =
                keys.iter().flat_map(|key| self.wanted.remove(key).unwrap_or_default()).collect();
            mutants.sort_by_key(|&at| (self.mutants[at].start, at));
            let name = item.ident.to_string();
            let (of_type, value) = (item.ty.span().byte_range(), span.byte_range());
            let kind = Kind::Constant { name: name.clone(), of_type, value };
            let site = Site { range: end..end, kind, mutants };
            self.constants.push(Constant { site, name, named: Vec::new() });
        }
    }

    /// All sites. A constant that is named where the compiler computes, too, would have two values.
    fn sites(mut self, tokens: proc_macro2::TokenStream) -> Vec<Site> {
        let mut names = BTreeMap::new();
        count_names(tokens, &mut names);
        for constant in self.constants {
            let Constant { site, name, named } = constant;
            if names.get(&name) == Some(&(1 + named.len())) {
                let kind = |range| Site { range, kind: Kind::Named(name.clone()), mutants: Vec::new() };
                self.sites.extend(named.into_iter().map(kind));
                self.sites.push(site);
            }
        }
        self.sites.sort_by_key(|site| (site.range.start, site.kind.rank(), usize::MAX - site.range.end));
        self.sites
    }
}

fn count_names(tokens: proc_macro2::TokenStream, names: &mut BTreeMap<String, usize>) {
    for token in tokens {
        match token {
            TokenTree::Group(group) => count_names(group.stream(), names),
            TokenTree::Ident(name) => *names.entry(name.to_string()).or_default() += 1,
            _ => (),
        }
    }
}

/// Is this a condition, or a part of one, that binds names?
fn binds(expression: &Expr) -> bool {
    match expression {
        Expr::Let(_) => true,
        Expr::Binary(pair) => binds(&pair.left) || binds(&pair.right),
        _ => false,
    }
}

impl<'a> Visit<'a> for Finder<'_> {
    fn visit_item_const(&mut self, _: &'a syn::ItemConst) {}
    fn visit_impl_item_const(&mut self, _: &'a syn::ImplItemConst) {}
    fn visit_trait_item_const(&mut self, _: &'a syn::TraitItemConst) {}
    fn visit_item_static(&mut self, _: &'a syn::ItemStatic) {}
    fn visit_expr_const(&mut self, _: &'a syn::ExprConst) {}
    fn visit_type(&mut self, _: &'a syn::Type) {}
    fn visit_generic_argument(&mut self, _: &'a syn::GenericArgument) {}
    fn visit_pat(&mut self, _: &'a syn::Pat) {}

    fn visit_expr_repeat(&mut self, repeat: &'a syn::ExprRepeat) {
        self.visit_expr(&repeat.expr);
    }

    fn visit_item_fn(&mut self, item: &'a syn::ItemFn) {
        self.body(&item.block);
        visit::visit_item_fn(self, item);
    }

    fn visit_impl_item_fn(&mut self, item: &'a syn::ImplItemFn) {
        self.body(&item.block);
        visit::visit_impl_item_fn(self, item);
    }

    fn visit_trait_item_fn(&mut self, item: &'a syn::TraitItemFn) {
        if let Some(block) = &item.default {
            self.body(block);
        }
        visit::visit_trait_item_fn(self, item);
    }

    fn visit_arm(&mut self, arm: &'a syn::Arm) {
        let end = arm.pat.span().byte_range().end;
        self.add("MatchArm", arm.span(), end..end, Kind::Arm);
        if let Some((_, guard)) = arm.guard.as_ref().filter(|(_, guard)| !binds(guard)) {
            self.add("MatchArmGuard", guard.span(), guard.span().byte_range(), Kind::Guard);
        }
        visit::visit_arm(self, arm);
    }

    fn visit_expr_path(&mut self, path: &'a syn::ExprPath) {
        if let Some(name) = path.path.get_ident()
            && let Some(constant) = self.constants.iter_mut().find(|constant| name == &constant.name)
        {
            constant.named.push(path.span().byte_range());
        }
    }

    fn visit_expr_struct(&mut self, structure: &'a syn::ExprStruct) {
        let of_field = |field: &syn::FieldValue| self.wanted.remove(&("StructField", place(field.span())));
        let mutants: Vec<usize> = structure.fields.iter().filter_map(of_field).flatten().collect();
        if !mutants.is_empty() {
            self.sites.push(Site { range: structure.span().byte_range(), kind: Kind::Fields, mutants });
        }
        visit::visit_expr_struct(self, structure);
    }

    fn visit_expr_unary(&mut self, unary: &'a syn::ExprUnary) {
        let operator = match unary.op {
            UnOp::Neg(_) => "-",
            _ => "!",
        };
        let kind = Kind::Unary { operator: operator.to_owned(), operand: unary.expr.span().byte_range() };
        self.add("UnaryOperator", unary.op.span(), unary.span().byte_range(), kind);
        visit::visit_expr_unary(self, unary);
    }

    fn visit_expr_binary(&mut self, pair: &'a syn::ExprBinary) {
        let range = pair.span().byte_range();
        let [left, right] = [&pair.left, &pair.right].map(|side| side.span().byte_range());
        let operator = pair.op.span().source_text().unwrap_or_default();
        if !matches!(pair.op, BinOp::And(_) | BinOp::Or(_)) || !(binds(&pair.left) || binds(&pair.right)) {
            let kind = Kind::Binary { left, operator, right };
            self.add("BinaryOperator", pair.op.span(), range, kind);
        }
        visit::visit_expr_binary(self, pair);
    }
}

/// A source file, what is rewritten there, and the numbers that its mutants get.
struct Rewriting<'m> {
    text: &'m str,
    sites: &'m [Site],
    mutants: &'m [Mutant],
    /// Position in the list by number less one; the numbers of one site follow each other.
    numbers: &'m mut Vec<usize>,
}

impl Rewriting<'_> {
    /// The text of a range, with the sites in it from number `from` on.
    fn render(&mut self, range: Range<usize>, from: usize) -> String {
        let (mut out, mut at) = (String::new(), range.start);
        for number in from..self.sites.len() {
            let site = &self.sites[number].range;
            if site.start >= at && site.end <= range.end {
                out.push_str(&self.text[at..site.start]);
                at = site.end;
                out.push_str(&self.site(number));
            }
        }
        out.push_str(&self.text[at..range.end]);
        out
    }

    /// The text of a range with one mutant in it, on a line.
    fn mutated(&self, range: &Range<usize>, mutant: &Mutant) -> String {
        let byte = |(line, column): LineColumn| {
            let before: usize = self.text.split_inclusive('\n').take(line - 1).map(str::len).sum();
            before + self.text[before..].chars().take(column - 1).map(char::len_utf8).sum::<usize>()
        };
        let (before, after) = (range.start..byte(mutant.start), byte(mutant.end)..range.end);
        [&self.text[before], &mutant.replacement, &self.text[after]].concat().replace('\n', " ")
    }

    fn site(&mut self, number: usize) -> String {
        let Site { range, kind, mutants } = &self.sites[number];
        let (mutants, inside) = (mutants.clone(), number + 1);
        let (first, count) = (self.numbers.len() + 1, mutants.len());
        self.numbers.extend(&mutants);
        let original = format!("crate::__mutants::original({first}, {count})");
        let replacement = |of: usize| self.mutants[mutants[of]].replacement.clone();
        let chosen = |of: usize| format!("crate::__mutants::chosen({})", first + of);
        // Each mutant has a line of its own, by which it is found where the compiler refuses it.
        let either = |this: &str, others: Vec<String>| {
            let mut text = format!("if {original} {{ {this} }}\n");
            for (of, other) in others.iter().enumerate() {
                if of + 1 < count {
                    text += &format!("else if {} {{ {other} }}\n", chosen(of));
                } else {
                    text += &format!("else {{ /* {} */ {other} }}\n", chosen(of));
                }
            }
            text
        };
        match kind {
            Kind::Body => {
                let replaced =
                    (0..count).map(|of| format!("\nif {} {{ return {} }}", chosen(of), replacement(of)));
                format!("if !{original} {{ {}\n }}\n", replaced.collect::<String>())
            }
            Kind::Arm => format!(" if {original}"),
            Kind::Named(name) => format!("(*{name}__chosen())"),
            Kind::Emptied => {
                let all = self.render(range.clone(), inside);
                format!(
                    "{{ let __all = {{ {all} }};\n__all.take(if {original} {{ usize::MAX }} else {{ 0 }}) }}"
                )
            }
            Kind::Fields => {
                let others = (0..count).map(|of| {
                    let other = self.mutated(range, &self.mutants[mutants[of]]);
                    format!("if {} {{ {other} }}\nelse ", chosen(of))
                });
                let others: String = others.collect();
                format!("({others} {{ {} }})", self.render(range.clone(), inside))
            }
            Kind::Constant { name, of_type, value } => {
                let of_type = &self.text[of_type.clone()];
                let others = (0..count).map(|of| {
                    let other = self.mutated(value, &self.mutants[mutants[of]]);
                    format!("if {} {{ const OTHER: {of_type} = {other}; return &OTHER; }}\n", chosen(of))
                });
                let others: String = others.collect();
                let head =
                    format!("#[allow(non_snake_case)]\nconst fn {name}__chosen() -> &'static {of_type}");
                format!("\n{head} {{\n{others}&{name} }}\n")
            }
            Kind::Guard => {
                let others = (0..count).map(replacement).collect();
                let this = self.render(range.clone(), inside);
                format!("({})", either(&this, others))
            }
            Kind::Unary { operator, operand } => {
                let operand = self.render(operand.clone(), inside);
                let choice = either(&format!("{operator}__x"), vec!["__x".to_owned()]);
                format!("(match ({operand}) {{ __x => {choice} }})")
            }
            Kind::Binary { left, operator, right } => {
                let others: Vec<String> = (0..count).map(replacement).collect();
                let [left, right] = [left, right].map(|side| self.render(side.clone(), inside));
                let with = |left: &str, right: &str| {
                    let this = format!("{left} {operator} {right}");
                    either(&this, others.iter().map(|other| format!("{left} {other} {right}")).collect())
                };
                match operator.as_str() {
                    "&&" => {
                        format!(
                            "(match ({left}) {{ __x => if __x == {original} {{ {right} }} else {{ __x }} }})"
                        )
                    }
                    "||" => {
                        format!(
                            "(match ({left}) {{ __x => if __x != {original} {{ {right} }} else {{ __x }} }})"
                        )
                    }
                    "==" | "!=" | "<" | ">" | "<=" | ">=" => {
                        format!(
                            "(match (&({left}), &({right})) {{ (__x, __y) => {} }})",
                            with("*__x", "*__y")
                        )
                    }
                    assigning if assigning.ends_with('=') => {
                        let choice = with("*__x", "__y");
                        format!("(match ({right}) {{ __y => match &mut ({left}) {{ __x => {choice} }} }})")
                    }
                    _ => format!("(match ({left}, {right}) {{ (__x, __y) => {} }})", with("__x", "__y")),
                }
            }
        }
    }
}

/// A tree of sources, and its copy.
pub struct Tree {
    pub sources: PathBuf,
    pub copy: PathBuf,
    /// All files of the tree.
    pub files: Vec<String>,
}

/// Writes the copy, with mutants, and says which of them has which number, from one on. Those that are not in
/// code that runs, or in a form that is not known here, have none.
pub fn plant(tree: &Tree, mutants: &[Mutant], refused: &BTreeSet<usize>) -> Vec<usize> {
    let mut numbers = Vec::new();
    let changed: BTreeSet<&str> = mutants.iter().map(|mutant| mutant.file.as_str()).collect();
    let mut texts: BTreeMap<String, String> = BTreeMap::new();
    for &file in &changed {
        let text = fs::read_to_string(tree.sources.join(file)).expect("a source file");
        let mut wanted: HashMap<(&str, LineColumn), Vec<usize>> = HashMap::new();
        for (at, mutant) in mutants.iter().enumerate() {
            let plantable = !opaque(mutant) || mutant.replacement == "::std::iter::empty()";
            if mutant.file == file && plantable && !refused.contains(&at) {
                wanted.entry((&mutant.genre, mutant.start)).or_default().push(at);
            }
        }
        let mut finder = Finder { mutants, wanted, sites: Vec::new(), constants: Vec::new() };
        let parsed = syn::parse_file(&text).expect("a source file in Rust");
        finder.constants(&parsed.items);
        finder.visit_file(&parsed);
        let sites = finder.sites(text.parse().expect("a source file in Rust"));
        let mut rewriting = Rewriting { text: &text, sites: &sites, mutants, numbers: &mut numbers };
        texts.insert(file.to_owned(), rewriting.render(0..text.len(), 0));
    }
    let crates: BTreeSet<&str> = changed.iter().filter_map(|file| file.split('/').next()).collect();
    for name in crates {
        let root = format!("{name}/src/lib.rs");
        let read = || fs::read_to_string(tree.sources.join(&root)).expect("the root of a crate");
        let text = texts.remove(&root).unwrap_or_else(read).replace("#![forbid(unsafe_code)]", "");
        let switch = SWITCH.replace("COUNT", &(numbers.len() + 1).to_string());
        texts.insert(root, format!("{HEAD}{text}{switch}"));
    }
    for file in &tree.files {
        match texts.get(file) {
            Some(text) => write(&tree.copy.join(file), text.as_bytes()),
            // Listed, but removed.
            None => {
                fs::read(tree.sources.join(file)).map_or((), |bytes| write(&tree.copy.join(file), &bytes))
            }
        }
    }
    numbers
}

/// What has not changed is left alone, so that it is not compiled again.
fn write(path: &Path, bytes: &[u8]) {
    if fs::read(path).ok().as_deref() != Some(bytes) {
        fs::create_dir_all(path.parent().expect("a folder")).expect("a copy that can be written");
        fs::write(path, bytes).expect("a copy that can be written");
    }
}

const HEAD: &str = "#![feature(core_intrinsics, const_eval_select)]\n#![allow(internal_features)]\n";

/// Which mutant runs, or that sites write down that they were reached.
const SWITCH: &str = r#"
#[doc(hidden)]
#[allow(missing_docs)]
pub mod __mutants {
    extern crate std;
    use core::sync::atomic::{AtomicBool, AtomicU32, Ordering::Relaxed};

    const UNKNOWN: u32 = u32::MAX;
    const RECORDS: u32 = u32::MAX - 1;
    static ACTIVE: AtomicU32 = AtomicU32::new(UNKNOWN);
    static SEEN: [AtomicBool; COUNT] = [const { AtomicBool::new(false) }; COUNT];

    #[inline(always)]
    pub const fn original(first: u32, count: u32) -> bool {
        core::intrinsics::const_eval_select((first, count), compiled, running)
    }

    #[inline(always)]
    pub const fn chosen(number: u32) -> bool {
        !original(number, 1)
    }

    const fn compiled(_: u32, _: u32) -> bool {
        true
    }

    #[inline(always)]
    fn running(first: u32, count: u32) -> bool {
        let active = ACTIVE.load(Relaxed);
        if active < RECORDS { active.wrapping_sub(first) >= count } else { slow(first, count) }
    }

    #[cold]
    #[inline(never)]
    fn slow(first: u32, count: u32) -> bool {
        if ACTIVE.load(Relaxed) == UNKNOWN {
            let number = std::env::var("MUTANT").ok().and_then(|number| number.parse().ok()).unwrap_or(0);
            ACTIVE.store(if std::env::var_os("MUTANTS_RECORD").is_some() { RECORDS } else { number }, Relaxed);
            return running(first, count);
        }
        if !SEEN[first as usize].load(Relaxed) && !SEEN[first as usize].swap(true, Relaxed) {
            use std::io::Write;
            let path = std::env::var_os("MUTANTS_RECORD").unwrap_or_default();
            let file = std::fs::OpenOptions::new().append(true).create(true).open(path);
            let _ = file.and_then(|mut file| file.write_all(std::format!("{first}\n").as_bytes()));
        }
        true
    }
}
"#;
