//! The documents: two pages at the front, and links that lead somewhere.
#![allow(clippy::unwrap_used)]

use std::fs;
use std::path::{Path, PathBuf};

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Every Markdown file but those of builds.
fn documents() -> Vec<PathBuf> {
    let mut folders = vec![root().to_owned()];
    let mut found = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_str().unwrap();
            if path.is_dir() && !name.starts_with('.') && name != "target" {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "md") {
                found.push(path);
            }
        }
    }
    found
}

/// Text outside of code.
fn prose(text: &str) -> String {
    let blocks = text.split("```").step_by(2);
    blocks
        .flat_map(|block| block.split('`').step_by(2))
        .collect()
}

/// Where the links of a text lead.
fn links(text: &str) -> Vec<&str> {
    let ends = text.split("](").skip(1);
    ends.filter_map(|rest| Some(rest.split_once(')')?.0))
        .collect()
}

/// How a heading is named in a link.
fn anchor(heading: &str) -> String {
    let kept = heading.trim().to_lowercase();
    kept.chars()
        .filter(|c| c.is_alphanumeric() || " -_".contains(*c))
        .map(|c| if c == ' ' { '-' } else { c })
        .collect()
}

fn leads_somewhere(document: &Path, link: &str) -> bool {
    let (file, part) = link.split_once('#').unwrap_or((link, ""));
    let target = match file {
        "" => document.to_owned(),
        file => document.parent().unwrap().join(file),
    };
    let has_part = || {
        let text = fs::read_to_string(&target).unwrap_or_default();
        let mut headings = text.lines().filter(|line| line.starts_with('#'));
        headings.any(|line| anchor(line.trim_start_matches('#')) == part)
    };
    target.exists() && (part.is_empty() || has_part())
}

#[test]
fn the_readme_has_two_pages() {
    let readme = fs::read_to_string(root().join("README.md")).unwrap();
    let lines: Vec<&str> = readme.lines().collect();
    assert!(lines.len() <= 150, "{} lines", lines.len());
    let long: Vec<&&str> = lines.iter().filter(|l| l.chars().count() > 120).collect();
    assert!(long.is_empty(), "{long:#?}");
}

#[test]
fn every_link_leads_somewhere() {
    let mut count = 0;
    let mut dead = Vec::new();
    for document in documents() {
        let text = fs::read_to_string(&document).unwrap();
        let prose = prose(&text);
        for link in links(&prose)
            .into_iter()
            .filter(|link| !link.contains("://"))
        {
            count += 1;
            if !leads_somewhere(&document, link) {
                dead.push(format!("{}: {link}", document.display()));
            }
        }
    }
    assert!(count > 50, "{count} links were found");
    assert!(dead.is_empty(), "{dead:#?}");
}

#[test]
fn a_dead_link_is_found() {
    let readme = root().join("README.md");
    assert!(leads_somewhere(&readme, "boards/README.md"));
    assert!(!leads_somewhere(&readme, "boards/nothing.md"));
    assert!(!leads_somewhere(
        &readme,
        "boards/README.md#nothing-of-that-name"
    ));
    assert_eq!(links("[a](b.md) and [`c`](d#e)"), ["b.md", "d#e"]);
    assert_eq!(anchor(" In the car, by day"), "in-the-car-by-day");
}
