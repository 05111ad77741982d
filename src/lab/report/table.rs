//! Heads of the page's tables.

use maud::{Markup, Render, html};

/// The name of a column.
pub enum Column {
    /// Of words.
    Words(&'static str),
    /// Of numbers, which are set to the right.
    Numbers(&'static str),
}

impl Render for Column {
    fn render(&self) -> Markup {
        html! {
            @match self {
                Self::Words(name) => th scope="col" { (name) },
                Self::Numbers(name) => th.n scope="col" { (name) },
            }
        }
    }
}

/// The head of a table.
pub fn head(columns: &[Column]) -> Markup {
    html! {
        thead { tr { @for column in columns { (column) } } }
    }
}
