//! The layers of the library: each uses only those before it, and no file of it or of the program stands in a circle
//! with another.
//!
//! Reads the sources as they are, without their tests, and follows every path to the file that defines what it names, through
//! imports and re-exports.
#![allow(clippy::unwrap_used)]

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use proc_macro2::{TokenStream, TokenTree};
use quote::ToTokens;
use syn::{Attribute, ImplItem, Item, UseTree};

/// In the order of the data.
const LAYERS: [&str; 12] = [
    "files",
    "statistics",
    "capture",
    "model",
    "features",
    "reference",
    "monitor",
    "can",
    "record",
    "live",
    "calibration",
    "lab",
];
/// Most lines of a file.
const LINES_MAX: usize = 600;

type Names = Vec<String>;

#[derive(Default)]
struct Module {
    file: PathBuf,
    parent: usize,
    children: BTreeMap<String, usize>,
    items: BTreeSet<String>,
    /// By the name that it has here.
    imports: BTreeMap<String, Names>,
    globs: Vec<Names>,
    uses: Vec<Names>,
}

/// All modules, the root first.
struct Modules(Vec<Module>);

impl Modules {
    fn of(root: &Path) -> Self {
        let mut modules = Self(vec![Module {
            file: root.to_owned(),
            ..Module::default()
        }]);
        modules.read(0, root, &root.with_file_name(""));
        modules
    }

    fn read(&mut self, module: usize, file: &Path, folder: &Path) {
        let text = fs::read_to_string(file).unwrap();
        self.take(module, syn::parse_file(&text).unwrap().items, folder);
    }

    fn take(&mut self, module: usize, items: Vec<Item>, folder: &Path) {
        for item in items {
            match item {
                item if attributes(&item).iter().any(is_of_tests) => {}
                Item::Mod(child) => {
                    let name = child.ident.to_string();
                    let number = self.0.len();
                    let (within, file) = (folder.join(&name), folder.join(format!("{name}.rs")));
                    self.0.push(Module {
                        parent: module,
                        ..Module::default()
                    });
                    self.0[module].children.insert(name, number);
                    if let Some((_, items)) = child.content {
                        self.0[number].file = self.0[module].file.clone();
                        self.take(number, items, &within);
                    } else {
                        self.0[number].file.clone_from(&file);
                        self.read(number, &file, &within);
                    }
                }
                Item::Use(tree) => self.import(module, &tree.tree, &mut Vec::new()),
                Item::Impl(mut of) => {
                    of.items.retain(|item| match item {
                        ImplItem::Fn(function) => !function.attrs.iter().any(is_of_tests),
                        _ => true,
                    });
                    paths(of.to_token_stream(), &mut self.0[module].uses);
                }
                item => {
                    self.0[module].items.extend(name_of(&item));
                    paths(item.to_token_stream(), &mut self.0[module].uses);
                }
            }
        }
    }

    fn import(&mut self, module: usize, tree: &UseTree, before: &mut Names) {
        let of = &mut self.0[module];
        let (name, path) = match tree {
            UseTree::Path(path) => {
                before.push(path.ident.to_string());
                self.import(module, &path.tree, before);
                before.pop();
                return;
            }
            UseTree::Group(group) => {
                for tree in &group.items {
                    self.import(module, tree, before);
                }
                return;
            }
            UseTree::Glob(_) => {
                of.globs.push(before.clone());
                of.uses.push(before.clone());
                return;
            }
            UseTree::Name(name) if name.ident == "self" => {
                (before.last().unwrap().clone(), before.clone())
            }
            UseTree::Name(name) => {
                let name = name.ident.to_string();
                (name.clone(), [&before[..], &[name]].concat())
            }
            UseTree::Rename(name) => {
                let path = [&before[..], &[name.ident.to_string()]].concat();
                (name.rename.to_string(), path)
            }
        };
        of.uses.push(path.clone());
        of.imports.insert(name, path);
    }

    /// The module that defines what a path names, seen from another one; `None` of what is not ours.
    fn definer(&self, from: usize, path: &[String], depth: usize) -> Option<usize> {
        let (first, rest) = path.split_first()?;
        let at = match first.as_str() {
            "crate" => 0,
            "self" => from,
            "super" => self.0[from].parent,
            _ => return self.named(from, path, depth),
        };
        match rest.first().map(String::as_str) {
            None => Some(at),
            Some("self" | "super") => self.definer(at, rest, depth),
            Some(_) => self.named(at, rest, depth),
        }
    }

    fn named(&self, at: usize, path: &[String], depth: usize) -> Option<usize> {
        let (first, rest) = path.split_first().filter(|_| depth < 16)?;
        let module = &self.0[at];
        let through = |path: &Names| self.definer(at, &[path, rest].concat(), depth + 1);
        if let Some(&child) = module.children.get(first) {
            return self.named(child, rest, depth).or(Some(child));
        }
        if module.items.contains(first) {
            return Some(at);
        }
        if let Some(import) = module.imports.get(first) {
            return through(import).filter(|_| import[0] != *first);
        }
        let mut globs = module.globs.iter();
        globs.find_map(|glob| through(&[&glob[..], std::slice::from_ref(first)].concat()))
    }

    /// Which files use which, with a path that does.
    fn uses(&self) -> BTreeMap<(PathBuf, PathBuf), String> {
        let mut uses = BTreeMap::new();
        for (number, module) in self.0.iter().enumerate() {
            for path in &module.uses {
                let definer = self.definer(number, path, 0).filter(|&definer| definer > 0);
                let Some(file) = definer.map(|definer| &self.0[definer].file) else {
                    continue;
                };
                if *file != module.file {
                    let edge = (module.file.clone(), file.clone());
                    uses.entry(edge)
                        .or_insert_with(|| line_of(&module.file, path));
                }
            }
        }
        uses
    }
}

fn attributes(item: &Item) -> &[Attribute] {
    match item {
        Item::Const(of) => &of.attrs,
        Item::Enum(of) => &of.attrs,
        Item::Fn(of) => &of.attrs,
        Item::Impl(of) => &of.attrs,
        Item::Mod(of) => &of.attrs,
        Item::Static(of) => &of.attrs,
        Item::Struct(of) => &of.attrs,
        Item::Use(of) => &of.attrs,
        _ => &[],
    }
}

fn is_of_tests(attribute: &Attribute) -> bool {
    let text = attribute.to_token_stream().to_string();
    text.starts_with("# [cfg (test") || text.starts_with("# [cfg (all (test")
}

fn name_of(item: &Item) -> Option<String> {
    let name = match item {
        Item::Const(of) => &of.ident,
        Item::Enum(of) => &of.ident,
        Item::Fn(of) => &of.sig.ident,
        Item::Static(of) => &of.ident,
        Item::Struct(of) => &of.ident,
        Item::Trait(of) => &of.ident,
        Item::Type(of) => &of.ident,
        _ => return None,
    };
    Some(name.to_string())
}

/// Every path `a::b::c`, and every name that may be of a type.
fn paths(tokens: TokenStream, found: &mut Vec<Names>) {
    let mut path: Names = Vec::new();
    let mut colons = 0;
    for token in tokens {
        match token {
            TokenTree::Ident(name) if colons == 2 => path.push(name.to_string()),
            TokenTree::Ident(name) => {
                found.push(std::mem::replace(&mut path, vec![name.to_string()]));
            }
            TokenTree::Punct(mark) if mark.as_char() == ':' && !path.is_empty() => {
                colons += 1;
                continue;
            }
            TokenTree::Group(group) => paths(group.stream(), found),
            _ => found.push(std::mem::take(&mut path)),
        }
        colons = 0;
    }
    found.push(path);
    found.retain(|path| {
        path.len() > 1 || path.iter().any(|name| name.starts_with(char::is_uppercase))
    });
}

/// Where a file names a path, as far as text tells.
fn line_of(file: &Path, path: &[String]) -> String {
    let text = fs::read_to_string(file).unwrap();
    let last = path.last().unwrap();
    let line = text.lines().position(|line| line.contains(last.as_str()));
    let line = line.map_or(0, |line| line + 1);
    format!("{}:{line}: {}", file.display(), path.join("::"))
}

fn sources() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("src")
}

fn layer(file: &Path) -> Option<usize> {
    let within = file.strip_prefix(sources()).unwrap().with_extension("");
    let first = within.components().next()?.as_os_str().to_str()?.to_owned();
    LAYERS.iter().position(|layer| *layer == first)
}

#[test]
fn a_layer_uses_only_those_before_it() {
    let modules = Modules::of(&sources().join("lib.rs"));
    let mut named: Vec<&str> = modules.0[0].children.keys().map(String::as_str).collect();
    named.sort_by_key(|name| LAYERS.iter().position(|layer| layer == name));
    assert_eq!(named, LAYERS);
    let uses = modules.uses();
    assert!(uses.len() > 400, "{} uses were found", uses.len());
    let wrong: Vec<&String> = uses
        .iter()
        .filter(|((from, to), _)| layer(from) < layer(to) && layer(from).is_some())
        .map(|(_, line)| line)
        .collect();
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn no_files_stand_in_a_circle() {
    for root in ["lib.rs", "main.rs"] {
        let uses = Modules::of(&sources().join(root)).uses();
        let wrong = circles(&uses);
        assert!(wrong.is_empty(), "{root}: {wrong:#?}");
    }
}

/// The lines by which files stand in circles.
fn circles(uses: &BTreeMap<(PathBuf, PathBuf), String>) -> Vec<&String> {
    let mut left: BTreeSet<&Path> = uses.keys().map(|(from, _)| from.as_path()).collect();
    // A file that uses nothing that is left stands in no circle, nor does one that nothing uses that is left.
    loop {
        let before = left.clone();
        let edges = || {
            uses.keys().filter(|(from, to)| {
                before.contains(from.as_path()) && before.contains(to.as_path())
            })
        };
        left.retain(|of| edges().any(|(from, _)| from == of) && edges().any(|(_, to)| to == of));
        if left == before {
            break;
        }
    }
    uses.iter()
        .filter(|((from, to), _)| left.contains(from.as_path()) && left.contains(to.as_path()))
        .map(|(_, line)| line)
        .collect()
}

#[test]
fn files_have_one_subject_and_few_lines() {
    let mut folders = vec![sources(), sources().with_file_name("tests")];
    let mut long = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let lines = fs::read_to_string(&path).unwrap().lines().count();
                if lines > LINES_MAX {
                    long.push(format!("{}: {lines} lines", path.display()));
                }
            }
        }
    }
    assert!(long.is_empty(), "{long:#?}");
}
