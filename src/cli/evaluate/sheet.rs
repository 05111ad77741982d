//! Tables of results, for a terminal or a Markdown file.

use std::io::{self, Write};

/// One table.
#[derive(Debug, Default, PartialEq)]
pub struct Sheet {
    /// The title, without a full stop.
    pub title: String,
    /// Headings; the first column names the rows.
    pub columns: Vec<String>,
    /// `[rows, columns]`
    pub rows: Vec<Vec<String>>,
    /// Notes, one line each.
    pub notes: Vec<String>,
}

impl Sheet {
    /// A table without rows.
    pub fn new<const N: usize>(title: String, columns: [&str; N]) -> Self {
        Self {
            title,
            columns: columns.map(str::to_owned).to_vec(),
            ..Self::default()
        }
    }

    /// Writes the table in columns that are as wide as needed. The first column is aligned to the left, the others to
    /// the right.
    pub fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        writeln!(out, "{}", self.title)?;
        let lines = || std::iter::once(&self.columns).chain(&self.rows);
        let widths: Vec<usize> = (0..self.columns.len())
            .map(|column| {
                let cells = lines().filter_map(|line| line.get(column));
                cells.map(|cell| cell.chars().count()).max().unwrap_or(0)
            })
            .collect();
        if !self.rows.is_empty() {
            for line in lines() {
                let cells = line.iter().zip(&widths).enumerate();
                let cells = cells.map(|(index, (cell, &width))| match index {
                    0 => format!("  {cell:<width$}"),
                    _ => format!("  {cell:>width$}"),
                });
                writeln!(out, "{}", cells.collect::<String>().trim_end())?;
            }
        }
        for note in &self.notes {
            writeln!(out, "  {note}")?;
        }
        writeln!(out)
    }

    /// Writes a Markdown table under a heading of the third level.
    pub fn markdown(&self, out: &mut dyn Write) -> io::Result<()> {
        writeln!(out, "### {}\n", self.title)?;
        if !self.rows.is_empty() {
            let row = |cells: &[String]| {
                let cells = cells.iter().map(|cell| cell.replace('|', "\\|"));
                format!("| {} |", cells.collect::<Vec<_>>().join(" | "))
            };
            writeln!(out, "{}", row(&self.columns))?;
            let rules = (0..self.columns.len()).map(|i| if i == 0 { "---|" } else { "---:|" });
            writeln!(out, "|{}", rules.collect::<String>())?;
            for cells in &self.rows {
                writeln!(out, "{}", row(cells))?;
            }
            writeln!(out)?;
        }
        for note in &self.notes {
            writeln!(out, "{note}\n")?;
        }
        Ok(())
    }
}

/// A number with its interval, both with this number of decimals.
pub fn with_interval(value: f64, interval: Option<(f64, f64)>, decimals: usize) -> String {
    match interval {
        Some((low, high)) => {
            format!("{value:.decimals$} ({low:.decimals$} to {high:.decimals$})")
        }
        None => format!("{value:.decimals$}"),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn written(with: impl Fn(&mut dyn Write) -> io::Result<()>) -> String {
        let mut bytes = Vec::new();
        with(&mut bytes).unwrap();
        String::from_utf8(bytes).unwrap()
    }

    #[test]
    fn a_table_is_the_same_cells_in_both_forms() {
        let mut sheet = Sheet::new("Found".to_owned(), ["severity", "1", "2"]);
        let row = ["fog", "0", "100|"].map(str::to_owned);
        sheet.rows.push(row.to_vec());
        sheet.notes.push("Of 20 drives.".to_owned());
        assert_eq!(
            written(|out| sheet.text(out)),
            "Found\n  severity  1     2\n  fog       0  100|\n  Of 20 drives.\n\n"
        );
        assert_eq!(
            written(|out| sheet.markdown(out)),
            "### Found\n\n| severity | 1 | 2 |\n|---|---:|---:|\n| fog | 0 | 100\\| |\n\nOf 20 drives.\n\n"
        );
    }

    #[test]
    fn numbers_carry_their_interval() {
        assert_eq!(
            with_interval(0.5, Some((0.25, 1.0)), 2),
            "0.50 (0.25 to 1.00)"
        );
        assert_eq!(with_interval(0.5, None, 1), "0.5");
    }
}
