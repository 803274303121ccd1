//! `fvi compare-engines`.

use crate::workplace::{Workplace, text};

#[test]
fn the_table_has_a_row_for_each_engine_and_length_and_every_engine_agrees() {
    let workplace = Workplace::new();
    let output = workplace.fvi(&[
        "compare-engines",
        "--lengths",
        "4,8",
        "--exponent",
        "-0.5,-0.8",
        "--out",
        "comparison",
    ]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let table = std::fs::read_to_string(workplace.path("comparison/engines.csv")).unwrap();
    let mut lines = table.lines();
    assert_eq!(
        lines.next().unwrap(),
        "engine,length,order,exponent,step_mean_ns,step_p50_ns,step_p999_ns,step_max_ns,bytes,max_error_u"
    );
    let rows: Vec<Vec<&str>> = lines.map(|line| line.split(',').collect()).collect();
    for engine in [
        "offline-fft",
        "exponential-sum",
        "exponential-sum-core",
        "block-fft",
        "real-time",
        "direct",
        "hls",
        "naive",
    ] {
        for (length, exponent) in [("16", "-0.5"), ("16", "-0.8"), ("256", "-0.5"), ("256", "-0.8")] {
            let same = |row: &&Vec<&str>| row[0] == engine && row[1] == length && row[3] == exponent;
            let row = rows.iter().find(same).unwrap();
            assert_eq!(row[2], "1");
            assert!(row[4].parse::<f64>().unwrap() > 0.0);
            if engine != "offline-fft" {
                let times: Vec<f64> = row[5..8].iter().map(|cell| cell.parse().unwrap()).collect();
                assert!(times.is_sorted(), "{row:?}");
            }
            if ["exponential-sum", "exponential-sum-core", "block-fft", "real-time", "direct"]
                .contains(&engine)
            {
                assert!(row[9].parse::<f64>().unwrap() <= 30.0, "{row:?}");
            }
            assert!(text(&output.stdout).contains(engine));
        }
    }
    for picture in ["step_time_order1_exponent-0.5.svg", "step_distribution_order1_exponent-0.5.svg"] {
        let svg = std::fs::read_to_string(workplace.path("comparison").join(picture)).unwrap();
        assert!(svg.contains("real-time"));
    }
}

#[test]
fn an_order_or_exponent_out_of_range_is_refused() {
    for arguments in [["--order", "7"], ["--exponent", "2"], ["--exponent", "-1"], ["--lengths", "99"]] {
        let workplace = Workplace::new();
        let output = workplace.fvi(&[&["compare-engines"], &arguments[..]].concat());
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(text(&output.stderr).contains(arguments[0]), "{}", text(&output.stderr));
        assert!(workplace.files().is_empty());
    }
}
