//! The page of a race: which strategy is best where, as text, pictures and tables, in one file.

use std::fmt::Write;

use fvi_rivals::fitted_exponent;

use crate::front::{
    break_even, eligible, families, fastest, front, front_and_ties, groups, least, quickest, winners,
};
use crate::picture::{self, Picture, Point, escaped};
use crate::plan::{Plan, SIGNALS};
use crate::record::{Kind, RaceRecord, Record, Row, counted};
use crate::strategy::Strategy;

const STYLE: &str = "body{font:15px/1.45 system-ui,sans-serif;max-width:1100px;margin:2em auto;padding:0 1em;color:#222}\
h1{font-size:1.5em}h2{font-size:1.2em;margin-top:2em}table{border-collapse:collapse;font-size:13px;margin:.6em 0}\
td,th{padding:2px 8px;border-bottom:1px solid #ddd;text-align:right}td:first-child,th:first-child{text-align:left}\
svg{width:100%;max-width:760px;display:block;margin:.5em 0}.no{color:#a33}code{background:#f4f4f4;padding:0 3px}";

/// Bytes of the name of a picture: file systems take 255.
const LONGEST_NAME: usize = 200;

/// A page, and its pictures, which are files of their own, too.
pub(crate) struct Page {
    pub(crate) html: String,
    pub(crate) pictures: Vec<PictureFile>,
}

/// What a file of a picture is made of.
pub(crate) struct PictureFile {
    /// Without an ending.
    pub(crate) name: String,
    title: String,
    body: String,
}

impl PictureFile {
    pub(crate) fn content(&self) -> String {
        picture::as_file(&self.title, &self.body)
    }
}

impl Page {
    /// Adds a picture to the page and, with a title of its own, to the files. Their names are letters,
    /// digits, points and dashes, not so long that a file system would refuse them.
    fn picture(&mut self, title: &str, words: &str, title_of_file: &str, picture: &Picture<'_>) {
        let body = picture.body();
        self.html.push_str(&picture::in_page(title, &body));
        let plain = |letter: char| if letter.is_alphanumeric() || letter == '.' { letter } else { '-' };
        let mut name: String = words.chars().map(plain).collect();
        while name.len() > LONGEST_NAME {
            name.pop();
        }
        while self.pictures.iter().any(|known| known.name.to_lowercase() == name.to_lowercase()) {
            name.push('-');
        }
        self.pictures.push(PictureFile { name, title: title_of_file.to_owned(), body });
    }
}

/// The whole page.
pub(crate) fn page(record: &Record, plan: &Plan, strategies: &[Strategy]) -> Page {
    let names: Vec<String> = strategies.iter().map(|strategy| strategy.name.clone()).collect();
    let title = plan.title.as_deref().unwrap_or("Strategies for online convolution");
    let mut page = format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>{0}</title><style>{STYLE}{1}</style></head><body>\n<h1>{0}</h1>\n",
        escaped(title),
        picture::STYLE
    );
    head(&mut page, record, plan);
    page.push_str("<h2>Which strategy wins where</h2>\n<ul>\n");
    for sentence in winners(record) {
        let _ = writeln!(page, "<li>{}</li>", escaped(&sentence));
    }
    page.push_str("</ul>\n");
    winners_table(&mut page, record);
    found_out(&mut page, record);
    let mut whole = Page { html: page, pictures: Vec::new() };
    for races in families(record) {
        growth(&mut whole, &races, &names);
    }
    fronts(&mut whole, record, &names);
    let page = &mut whole.html;
    page.push_str("<h2>All numbers</h2>\n<p>Times in ns a step, and of a whole run with the construction of the strategy. \
        <i>between</i>: the median over the rounds lies there with a probability of 95 % \
        (with fewer than six rounds it is the range of them, and no median stands), and the medians of all processes do; \
        <i>pays from</i>: a run of so many steps or more is over sooner, construction included, than with any strategy that keeps the \
        tolerance and has a longer step; ties are those whose intervals overlap, 5 % to either side at least. \
        Times of single steps are the smallest of all rounds. \
        † sums weights of its own, and has its error from their plain sum. Numbers in red are beyond the tolerance. \
        <i>weights</i>: error of the quadrature itself on t², |Σwx − K(d/dt)t²|/Σ|w||x| at the end of the run, \
        where it is known; a smaller tolerance brings no sum closer to the operator.</p>\n");
    for race in &record.races {
        numbers(page, race);
    }
    page.push_str("<h2>The strategies</h2>\n<table><tr><th>name</th><th>what it is</th></tr>\n");
    for strategy in strategies {
        let (name, description) = (escaped(&strategy.name), escaped(&strategy.description));
        let _ = writeln!(page, "<tr><td><code>{name}</code></td><td>{description}</td></tr>");
    }
    page.push_str("</table>\n</body></html>\n");
    whole
}

fn head(page: &mut String, record: &Record, plan: &Plan) {
    let machine = &record.machine;
    let _ = writeln!(
        page,
        "<p>{} of {} races. Measured on {} ({} threads, {}, {}), compiled by {}, fvi {}. In a round of a race every strategy is made anew and timed, and all races have their first \
         round before any has its second. A race has further rounds until each median stands to 5&nbsp;% or they have taken {:.0}&nbsp;s, {} to {} of them. Errors are the largest |r − sum|/Σ|w||x| of the signals {}: at some fifty steps from the sum in twice the \
         precision, at the others from <code>block-fft</code> as far as its rounding goes. Signals come from SplitMix64 with seed 1.</p>",
        record.races.len(),
        plan.races(),
        escaped(&machine.processor),
        machine.threads,
        escaped(&machine.vector_units),
        escaped(&machine.system),
        escaped(&machine.compiler),
        escaped(&machine.version),
        plan.patience.as_secs_f64(),
        plan.rounds.0,
        plan.rounds.1,
        plan.signals
            .iter()
            .filter_map(|signal| SIGNALS.iter().find(|(_, known)| known == signal).map(|(name, _)| *name))
            .collect::<Vec<_>>()
            .join(", "),
    );
    page.push_str("<ul>\n");
    for kernel in &plan.kernels {
        let (name, description) = (escaped(&kernel.name), escaped(&kernel.description()));
        let _ = writeln!(page, "<li><b>{name}</b>: {description}</li>");
    }
    page.push_str("</ul>\n");
    let rows = || record.races.iter().flat_map(|race| &race.rows);
    let (all, restless) = (rows().count(), rows().filter(|row| !row.stands).count());
    if all == 0 {
        page.push_str("<p>There are no times yet.</p>\n");
    } else if restless == 0 {
        page.push_str("<p>Every median stands to 5 %.</p>\n");
    } else {
        let _ = writeln!(
            page,
            "<p class=\"no\">{restless} of {all} medians do not stand to 5&nbsp;%, and a second run may rank them otherwise; each is marked among the numbers below.</p>"
        );
    }
}

/// Bytes of a row as a number, for what is not known another one.
fn bytes_or(row: &Row, unknown: f64) -> f64 {
    row.bytes.map_or(unknown, |bytes| bytes as f64)
}

fn bytes(row: &Row) -> String {
    row.bytes.map_or_else(|| "not known".to_owned(), |bytes| format!("{bytes} bytes"))
}

fn winners_table(page: &mut String, record: &Record) {
    page.push_str("<table><tr><th>race</th><th>fastest, construction included</th><th>ties within the spread</th><th>shortest step</th><th>which pays from so many steps on</th><th>least memory</th><th>shortest p99.9</th><th>shortest worst step</th></tr>\n");
    for race in &record.races {
        let with = |row: Option<&Row>, of: fn(&Row) -> String| match row {
            Some(row) => format!("{} ({})", escaped(&row.strategy), of(row)),
            None => "–".to_owned(),
        };
        let (best, ties) = fastest(race).map_or((None, Vec::new()), |(best, ties)| (Some(best), ties));
        let ties: Vec<_> = ties.iter().map(|row| escaped(&row.strategy)).collect();
        let _ = writeln!(
            page,
            "<tr><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
            escaped(&race.words()),
            with(best, |row| format!("{} ms", number(1e-6 * row.total_ns))),
            if ties.is_empty() { "–".to_owned() } else { ties.join(", ") },
            with(quickest(race).map(|(row, _)| row), |row| format!("{} ns", number(row.mean_ns))),
            quickest(race)
                .and_then(|(row, _)| break_even(race, row))
                .map_or_else(|| "–".to_owned(), |steps| format!("{steps:.0}")),
            with(least(race, |row| bytes_or(row, f64::INFINITY)), bytes),
            with(least(race, |row| row.p999_ns), |row| format!("{} ns", number(row.p999_ns))),
            with(least(race, |row| row.worst_ns), |row| format!("{} ns", number(row.worst_ns))),
        );
    }
    page.push_str("</table>\n");
}

/// Section on strategies that failed, or whose sums were wrong.
fn found_out(page: &mut String, record: &Record) {
    let mut rows = String::new();
    for race in &record.races {
        for absence in race.absent.iter().filter(|absence| absence.kind == Kind::Failed) {
            let (name, reason) = (escaped(&absence.strategy), escaped(&absence.reason));
            let _ = writeln!(
                rows,
                "<tr><td>{name}</td><td>{}</td><td>{reason}</td></tr>",
                escaped(&race.words())
            );
        }
        for row in race.rows.iter().filter(|row| !row.within) {
            let error = row.error_u * race.precision.unit();
            let (name, words) = (escaped(&row.strategy), escaped(&race.words()));
            let bound = if row.promised { "" } else { "; it has no bound" };
            let _ = writeln!(
                rows,
                "<tr><td>{name}</td><td>{words}</td><td>its error is {error:.1e}{bound}</td></tr>"
            );
        }
    }
    if record.races.iter().all(|race| race.rows.is_empty()) && rows.is_empty() {
        page.push_str("<p>No strategy has been in a race yet.</p>\n");
    } else if rows.is_empty() {
        page.push_str("<p>Every strategy in the race kept the tolerance.</p>\n");
    } else {
        page.push_str("<h2>Failed, or beyond the tolerance</h2>\n<table><tr><th>strategy</th><th>race</th><th>what is wrong</th></tr>\n");
        page.push_str(&rows);
        page.push_str("</table>\n");
    }
    let mut sits_out: Vec<(String, String)> = Vec::new();
    for absence in
        record.races.iter().flat_map(|race| &race.absent).filter(|absence| absence.kind == Kind::SitsOut)
    {
        let entry = (absence.strategy.clone(), absence.reason.clone());
        if !sits_out.contains(&entry) {
            sits_out.push(entry);
        }
    }
    if !sits_out.is_empty() {
        page.push_str("<p>Who sits out some races: ");
        let all: Vec<_> = sits_out
            .iter()
            .map(|(name, reason)| format!("<code>{}</code>, {}", escaped(name), escaped(reason)))
            .collect();
        let _ = writeln!(page, "{}.</p>", all.join("; "));
    }
}

/// Cost against length, with fitted exponents.
fn growth(page: &mut Page, races: &[&RaceRecord], names: &[String]) {
    if races.len() < 2 {
        return;
    }
    let first = races[0];
    let heading = format!(
        "Cost against length: {}, {}, {}, tolerance {:e}",
        first.kernel,
        counted(first.channels, "channel"),
        first.precision.name(),
        first.tolerance
    );
    let mut picture = Picture { x: "steps", y: "ns a step", names, points: Vec::new(), lines: Vec::new() };
    let mut fits = String::new();
    for (series, name) in names.iter().enumerate() {
        let rows: Vec<(&RaceRecord, &Row)> = races
            .iter()
            .filter_map(|race| race.rows.iter().find(|row| row.strategy == *name).map(|row| (*race, row)))
            .collect();
        let times: Vec<(f64, f64)> =
            rows.iter().map(|(race, row)| (race.length as f64, row.mean_ns)).collect();
        let counts: Vec<(f64, f64)> = rows
            .iter()
            .filter_map(|(race, row)| row.flops.map(|flops| (race.length as f64, flops)))
            .collect();
        let from = picture.points.len();
        for (race, row) in &rows {
            let words = format!("{name}: {} ns at {}", number(row.mean_ns), counted(race.length, "step"));
            picture.points.push(Point { series, x: race.length as f64, y: row.mean_ns, words });
        }
        picture.lines.push(((from..picture.points.len()).collect(), true));
        let shown = |fit: Option<f64>| fit.map_or_else(|| "–".to_owned(), |fit| format!("{fit:.2}"));
        if !rows.is_empty() {
            let worst: Vec<(f64, f64)> =
                rows.iter().map(|(race, row)| (race.length as f64, row.worst_ns)).collect();
            let (time, count) = (shown(fitted_exponent(&times)), shown(fitted_exponent(&counts)));
            let worst = shown(fitted_exponent(&worst));
            let _ = writeln!(
                fits,
                "<tr><td>{}</td><td>{time}</td><td>{worst}</td><td>{count}</td></tr>",
                escaped(name)
            );
        }
    }
    let _ = writeln!(page.html, "<h2>{}</h2>", escaped(&heading));
    page.picture(&heading, &heading.replace("Cost against length:", "growth"), &heading, &picture);
    let _ = writeln!(
        page.html,
        "<p>Exponents p of cost ~ steps<sup>p</sup>, of a step, by least squares over these lengths:</p><table><tr><th>strategy</th><th>of mean time</th><th>of the worst step</th><th>of counted operations</th></tr>\n{fits}</table>"
    );
}

/// One view of the results.
struct View {
    /// Beginning of its file's name.
    file: &'static str,
    title: &'static str,
    x: &'static str,
    y: &'static str,
    of: fn(&RaceRecord, &Row) -> (f64, f64),
}

/// The Pareto fronts of error and cost at every length, over all tolerances.
fn fronts(page: &mut Page, record: &Record, names: &[String]) {
    let views = [
        View {
            file: "error-total",
            title: "Error and time of a run, construction included",
            x: "time of a run / ms",
            y: "error / Σ|w||x|",
            of: |race, row| (1e-6 * row.total_ns, row.error_u * race.precision.unit()),
        },
        View {
            file: "error-time",
            title: "Error and time of a step",
            x: "mean time of a step / ns",
            y: "error / Σ|w||x|",
            of: |race, row| (row.mean_ns, row.error_u * race.precision.unit()),
        },
        View {
            file: "error-bytes",
            title: "Error and memory",
            x: "bytes",
            y: "error / Σ|w||x|",
            of: |race, row| (bytes_or(row, f64::NAN), row.error_u * race.precision.unit()),
        },
        View {
            file: "worst-mean",
            title: "Worst step and mean step, within the tolerance",
            x: "mean time of a step / ns",
            y: "longest step / ns",
            of: |_, row| (row.mean_ns, row.worst_ns),
        },
        View {
            file: "p99.9-mean",
            title: "p99.9 and mean step, within the tolerance",
            x: "mean time of a step / ns",
            y: "99.9 % of the steps are no longer than / ns",
            of: |_, row| (row.mean_ns, row.p999_ns),
        },
    ];
    for group in groups(record) {
        let race = group[0];
        let heading = format!(
            "Pareto fronts: {}, {}, {}, {}",
            race.kernel,
            counted(race.length, "step"),
            counted(race.channels, "channel"),
            race.precision.name()
        );
        let _ = writeln!(page.html, "<h2>{}</h2>", escaped(&heading));
        for (index, view) in views.iter().enumerate() {
            let mut picture = Picture { x: view.x, y: view.y, names, points: Vec::new(), lines: Vec::new() };
            for race in &group {
                let rows: Vec<&Row> = if index >= 3 { eligible(race) } else { race.rows.iter().collect() };
                for row in rows {
                    let (x, y) = (view.of)(race, row);
                    // Bytes that are not known.
                    if x.is_nan() {
                        continue;
                    }
                    let series = names.iter().position(|name| *name == row.strategy).unwrap_or(0);
                    let words = format!("{}, tolerance {:e}: {x:.3e}, {y:.3e}", row.strategy, race.tolerance);
                    picture.points.push(Point { series, x, y, words });
                }
            }
            let points: Vec<(f64, f64)> = picture.points.iter().map(|point| (point.x, point.y)).collect();
            let best = front(&points);
            let mut on_it: Vec<String> = Vec::new();
            for &index in &best {
                let name = escaped(&names[picture.points[index].series]);
                if !on_it.contains(&name) {
                    on_it.push(name);
                }
            }
            picture.lines.push((best, false));
            let named = |words: &str| heading.replace("Pareto fronts", words);
            page.picture(view.title, &named(view.file).replace(": ", " "), &named(view.title), &picture);
            let page = &mut page.html;
            let _ = write!(page, "<p>On the front, from left to right: {}.", on_it.join(", "));
            let (_, ties) = if index == 0 { front_and_ties(&group) } else { Default::default() };
            if !ties.is_empty() {
                let ties: Vec<String> = ties.into_iter().map(escaped).collect();
                let _ = write!(page, " Within the spread of it: {}.", ties.join(", "));
            }
            page.push_str("</p>\n");
        }
    }
}

fn numbers(page: &mut String, race: &RaceRecord) {
    let _ = writeln!(page, "<h3>{} ({} rounds)</h3>", escaped(&race.words()), race.rounds);
    page.push_str("<table><tr><th>strategy</th><th>error / u</th><th>weights</th><th>mean</th><th>between</th><th>p50</th><th>p99.9</th><th>worst</th><th>construction / ns</th><th>whole run / ns</th><th>between</th><th>pays from</th><th>bytes</th><th>flops a step</th></tr>\n");
    for row in &race.rows {
        let _ = writeln!(
            page,
            "<tr{}><td>{}{}</td><td>{}</td><td>{}</td><td>{}{}</td><td>{}–{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}–{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
            if row.within { "" } else { " class=\"no\"" },
            escaped(&row.strategy),
            if row.own_weights { " †" } else { "" },
            number(row.error_u),
            row.quadrature.map_or_else(|| "–".to_owned(), |error| format!("{error:.0e}")),
            number(row.mean_ns),
            if row.stands { "" } else { " (does not stand)" },
            number(row.between_ns.0),
            number(row.between_ns.1),
            number(row.p50_ns),
            number(row.p999_ns),
            number(row.worst_ns),
            number(row.setup_ns),
            number(row.total_ns),
            number(row.total_between_ns.0),
            number(row.total_between_ns.1),
            break_even(race, row).map_or_else(|| "–".to_owned(), |steps| format!("{steps:.0}")),
            row.bytes.map_or_else(|| "–".to_owned(), |bytes| bytes.to_string()),
            row.flops.map_or_else(|| "–".to_owned(), number),
        );
    }
    page.push_str("</table>\n");
}

/// A number with three digits, or with a power of ten.
fn number(value: f64) -> String {
    match value.abs() {
        size if size >= 1e7 => format!("{value:.1e}"),
        size if size >= 100.0 => format!("{value:.0}"),
        size if size >= 10.0 => format!("{value:.1}"),
        _ => format!("{value:.2}"),
    }
}
