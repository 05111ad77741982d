//! `gapwatch report`: a journal as one HTML file.

use std::io::Write;

use anyhow::Context;
use gapwatch::files::whole_file::WholeFile;
use gapwatch::lab::report::Report;
use gapwatch::monitor::alarm::AlarmState;
use gapwatch::record::journal;

use super::output::{Kind, check_output};
use crate::cli::args::ReportArgs;

pub fn run(args: &ReportArgs, out: &mut dyn Write) -> anyhow::Result<u8> {
    let inputs = [Some(&args.journal), args.evidence.as_ref()];
    let inputs = inputs.into_iter().flatten();
    let inputs = inputs.filter_map(|input| Some(("the report", input.to_str()?)));
    check_output("--out", &args.out, Kind::Report, inputs)?;
    let mut report = Report::new(journal::read(&args.journal)?);
    if let Some(folder) = &args.evidence {
        report.show(folder)?;
    }
    let name = args.journal.file_name().unwrap_or_default();
    let page = report.page(&name.to_string_lossy());
    let cannot = || format!("cannot write {}", args.out.display());
    let mut file = WholeFile::create(&args.out).with_context(cannot)?;
    file.write_all(page.as_bytes()).with_context(cannot)?;
    file.finish().with_context(cannot)?;
    let counted = |states: &[AlarmState], one: &str| match report.count(states) {
        1 => format!("1 {one}"),
        count => format!("{count} {one}s"),
    };
    writeln!(
        out,
        "{}: {} lines, {:.1} s of drive, {}, {}, {}",
        args.out.display(),
        report.lines(),
        report.span_s(),
        counted(&[AlarmState::Gap], "alarm"),
        counted(&[AlarmState::Suspect], "suspicion"),
        counted(
            &[AlarmState::SensorFault, AlarmState::Unavailable],
            "outage"
        ),
    )?;
    Ok(0)
}
