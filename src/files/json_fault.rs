//! What is wrong with a JSON text, in plain words and without names of the program's types.

use serde_json::error::Category;

/// What was found, in one line, with its position if it is known.
pub fn fault(error: &serde_json::Error) -> String {
    let place = match (error.line(), error.column()) {
        (0, _) => String::new(),
        (line, column) => format!(" at line {line}, column {column}"),
    };
    let said = error.to_string();
    let named = |begin: &str| {
        let (name, _) = said.strip_prefix(begin)?.split_once('`')?;
        Some(name.to_owned())
    };
    match error.classify() {
        Category::Io => said,
        Category::Eof => format!("not JSON: it ends{place}"),
        Category::Syntax => format!("not JSON{place}"),
        Category::Data => {
            if let Some(name) = named("missing field `") {
                format!("no {name:?}{place}")
            } else if let Some(name) =
                named("unknown field `").or_else(|| named("unknown variant `"))
            {
                format!("{name:?}, which is not known,{place}")
            } else if let Some(name) = named("duplicate field `") {
                format!("{name:?} twice{place}")
            } else if ["invalid ", "data did not match"]
                .iter()
                .any(|begin| said.starts_with(begin))
            {
                format!("another kind of value than belongs there{place}")
            } else {
                // Our own error texts.
                let own = said
                    .split_once(" at line ")
                    .map_or(said.as_str(), |(own, _)| own);
                format!("{own}{place}")
            }
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use serde::Deserialize;

    use super::*;

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Of {
        #[serde(rename = "size")]
        _size: u8,
        #[serde(rename = "kind")]
        _kind: Option<Kind>,
    }

    #[derive(Debug, Deserialize)]
    #[serde(rename_all = "lowercase")]
    enum Kind {
        One,
    }

    #[test]
    fn faults_are_told_without_the_words_of_types() {
        for (text, said) in [
            ("", "not JSON: it ends at line 1, column 0"),
            ("{\"size\": 1", "not JSON: it ends at line 1, column 10"),
            ("{\n size: 1}", "not JSON at line 2, column 2"),
            ("{}", "no \"size\" at line 1, column 2"),
            (
                "{\"sizes\": 1}",
                "\"sizes\", which is not known, at line 1, column 8",
            ),
            (
                "{\"size\": 1, \"size\": 1}",
                "\"size\" twice at line 1, column 18",
            ),
            (
                "{\"size\": \"a\"}",
                "another kind of value than belongs there at line 1, column 12",
            ),
            (
                "{\"size\": 256}",
                "another kind of value than belongs there at line 1, column 12",
            ),
            (
                "{\"size\": 1, \"kind\": \"two\"}",
                "\"two\", which is not known, at line 1, column 25",
            ),
            (
                "[]",
                "another kind of value than belongs there at line 1, column 2",
            ),
        ] {
            let error = serde_json::from_str::<Of>(text).unwrap_err();
            assert_eq!(fault(&error), said, "{text}: {error}");
        }
        let one = serde_json::from_str::<Of>("{\"size\": 1, \"kind\": \"one\"}").unwrap();
        assert!(matches!(one._kind, Some(Kind::One)), "{one:?}");
        let metric =
            serde_json::from_str::<Vec<crate::reference::gap::Metric>>("[\n\"kl\"]").unwrap_err();
        let said = fault(&metric);
        assert!(
            said.starts_with("wanted one of paper, ") && said.contains("lane-risk at line 2, "),
            "{said}"
        );
        let value = serde_json::from_str("{}").unwrap();
        let error = serde_json::from_value::<Of>(value).unwrap_err();
        assert_eq!(fault(&error), "no \"size\"");
    }
}
