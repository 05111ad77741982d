//! What stands in the page as text: words of others, made harmless, and numbers.

use maud::{Markup, Render, html};

/// Text of others, set apart: whatever it holds, it stays text and turns no line around it.
pub struct Text<'a>(pub &'a str);

impl Render for Text<'_> {
    fn render(&self) -> Markup {
        html! { bdi { (Plain(self.0)) } }
    }
}

/// Text of others for attributes and titles: no control character is left.
pub struct Plain<'a>(pub &'a str);

impl Render for Plain<'_> {
    fn render_to(&self, out: &mut String) {
        self.0.replace(char::is_control, "\u{fffd}").render_to(out);
    }
}

/// A number with so many decimals, or a dash.
pub struct Number(pub Option<f64>, pub usize);

impl Render for Number {
    fn render_to(&self, out: &mut String) {
        let &Self(Some(number), decimals) = self else {
            return "–".render_to(out);
        };
        let shown = format!("{number:.decimals$}");
        // No minus sign before what rounds to nothing.
        let nothing = shown.trim_start_matches(['-', '0', '.']).is_empty();
        let shown = match shown.strip_prefix('-') {
            Some(unsigned) if nothing => unsigned,
            _ => &shown,
        };
        shown.render_to(out);
    }
}

/// A share of 1 as whole per cent, or a dash.
pub struct Percent(pub Option<f64>);

impl Render for Percent {
    fn render_to(&self, out: &mut String) {
        match self.0 {
            Some(share) => format!("{:.0} %", 100.0 * share).render_to(out),
            None => "–".render_to(out),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_of_others_has_no_markup_no_control_character_and_a_direction_of_its_own() {
        let hostile = "<b a='1'>\"&amp;\u{202e}\0\n\u{85}";
        let harmless = "&lt;b a='1'&gt;&quot;&amp;amp;\u{202e}\u{fffd}\u{fffd}\u{fffd}";
        let in_attribute = html! { i title=(Plain(hostile)) {} };
        assert_eq!(
            in_attribute.into_string(),
            format!("<i title=\"{harmless}\"></i>")
        );
        assert_eq!(
            Text(hostile).render().into_string(),
            format!("<bdi>{harmless}</bdi>")
        );
    }

    #[test]
    fn a_number_that_rounds_to_nothing_has_no_minus_sign() {
        let shown = |number| Number(number, 2).render().into_string();
        assert_eq!(shown(Some(-0.001)), "0.00");
        assert_eq!(shown(Some(-0.25)), "-0.25");
        assert_eq!(shown(Some(10.0)), "10.00");
        assert_eq!(shown(None), "–");
    }

    #[test]
    fn a_share_is_shown_as_whole_per_cent() {
        let shown = |share| Percent(share).render().into_string();
        assert_eq!(shown(Some(0.125)), "12 %");
        assert_eq!(shown(Some(1.0)), "100 %");
        assert_eq!(shown(None), "–");
    }
}
