//! The list of everything that the packages offer: `tests/public_api.txt`, one item a line. A change of it is seen in review.
//!
//! Sources are read by `syn`, modules followed from each `lib.rs`. An item stands where it can be reached by the shortest path of its own crate; what is
//! offered under another path too stands there as `use`. Fields, variants, implementations of traits and what macros write are not listed, nor what the
//! documentation leaves out (`#[doc(hidden)]`): the workspace's crates share that, and it is promised to nobody; its number is said.

use std::collections::{BTreeMap, BTreeSet};

use syn::{ImplItem, Item, TraitItem, UseTree, Visibility};

use crate::layering::sources;
use crate::root;

/// Where the list is recorded, and what has it recorded anew.
const LIST: &str = "tests/public_api.txt";
const RECORD: &str = "ISOPLANAT_RECORD_API";

/// Most items that may be offered.
const MOST: usize = 1200;

/// Folders and names of the packages' libraries.
const CRATES: [(&str, &str); 10] = [
    ("calibration/", "isoplanat_calibration"),
    ("crates/base/src/", "isoplanat_base"),
    ("crates/camera/src/", "isoplanat_camera"),
    ("crates/card/src/", "isoplanat_card"),
    ("crates/imaging/src/", "isoplanat_imaging"),
    ("crates/network/src/", "isoplanat_network"),
    ("crates/optics/src/", "isoplanat_optics"),
    ("crates/program/src/", "isoplanat_program"),
    ("models/", "isoplanat_models"),
    ("src/", "isoplanat"),
];

/// The crate's name, then the modules.
type Path = Vec<String>;

/// What a module holds.
#[derive(Default)]
struct Module {
    /// Name, kind, whether it is public; modules among them.
    items: Vec<(String, &'static str, bool)>,
    /// Name here, path as written, whether it is public; `*` is everything.
    uses: Vec<(String, Path, bool)>,
    /// The type's path as written, or the trait's name, with the names and kinds of what is public in it.
    members: Vec<(Path, Vec<(String, &'static str)>)>,
}

type Modules = BTreeMap<Path, Module>;

/// What a name stands for: the module that holds it, its name, its kind.
type Meant = (Path, String, &'static str);

/// Whether there is `#[NAME(WORD)]` among the attributes.
fn says(attributes: &[syn::Attribute], name: &str, word: &str) -> bool {
    attributes.iter().any(|a| a.path().is_ident(name) && a.parse_args::<syn::Ident>().is_ok_and(|i| i == word))
}

/// Which items count as offered.
#[derive(Clone, Copy, PartialEq)]
enum Of {
    /// Those that the documentation shows.
    Shown,
    /// Those that it leaves out, too: the workspace's crates share them.
    All,
}

impl Of {
    fn offered(self, visibility: &Visibility, attributes: &[syn::Attribute]) -> bool {
        let shown = self == Self::All || !says(attributes, "doc", "hidden");
        matches!(visibility, Visibility::Public(_)) && shown && !says(attributes, "cfg", "test")
    }
}

/// The paths that a `use` names, with the names they get.
fn spelled(tree: &UseTree, before: &[String], found: &mut Vec<(String, Path)>) {
    let with = |name: &syn::Ident| before.iter().cloned().chain([name.to_string()]).collect::<Path>();
    match tree {
        UseTree::Path(p) => spelled(&p.tree, &with(&p.ident), found),
        UseTree::Name(n) if n.ident == "self" => found.push((before[before.len() - 1].clone(), before.to_vec())),
        UseTree::Name(n) => found.push((n.ident.to_string(), with(&n.ident))),
        UseTree::Rename(r) if r.ident == "self" => found.push((r.rename.to_string(), before.to_vec())),
        UseTree::Rename(r) => found.push((r.rename.to_string(), with(&r.ident))),
        UseTree::Glob(_) => found.push(("*".into(), before.to_vec())),
        UseTree::Group(g) => g.items.iter().for_each(|t| spelled(t, before, found)),
    }
}

/// Name and kind of an item that is none of a module's, an implementation's or a `use`, with whether it is public.
fn named(item: &Item, of: Of) -> Option<(String, &'static str, bool)> {
    let (ident, kind, visibility, attributes) = match item {
        Item::Const(i) => (&i.ident, "const", &i.vis, &i.attrs),
        Item::Enum(i) => (&i.ident, "enum", &i.vis, &i.attrs),
        Item::Fn(i) => (&i.sig.ident, "fn", &i.vis, &i.attrs),
        Item::Static(i) => (&i.ident, "static", &i.vis, &i.attrs),
        Item::Struct(i) => (&i.ident, "struct", &i.vis, &i.attrs),
        Item::Trait(i) => (&i.ident, "trait", &i.vis, &i.attrs),
        Item::Type(i) => (&i.ident, "type", &i.vis, &i.attrs),
        Item::Union(i) => (&i.ident, "union", &i.vis, &i.attrs),
        Item::Macro(i) => {
            let offered = i.attrs.iter().any(|a| a.path().is_ident("macro_export"));
            return i.ident.as_ref().map(|name| (name.to_string(), "macro", offered));
        }
        _ => return None,
    };
    Some((ident.to_string(), kind, of.offered(visibility, attributes)))
}

/// Takes a module's items apart; modules in files of their own are read from `files`, whose folder for this module is `folder`.
fn read(items: &[Item], at: Path, folder: &str, (files, offered): (&BTreeMap<String, String>, Of), all: &mut Modules) {
    let mut module = Module::default();
    for item in items {
        match item {
            Item::Mod(m) if says(&m.attrs, "cfg", "test") => {}
            Item::Mod(m) => {
                let (name, below) = (m.ident.to_string(), format!("{folder}{}/", m.ident));
                let inner = at.iter().cloned().chain([name.clone()]).collect();
                module.items.push((name, "mod", offered.offered(&m.vis, &m.attrs)));
                if let Some((_, items)) = &m.content {
                    read(items, inner, &below, (files, offered), all);
                    continue;
                }
                let file = [format!("{}.rs", below.trim_end_matches('/')), format!("{below}mod.rs")];
                let text = file.iter().find_map(|f| files.get(f)).unwrap_or_else(|| panic!("no file of {inner:?}"));
                read(&parsed(text, &inner.join("::")), inner, &below, (files, offered), all);
            }
            Item::Use(u) => {
                let mut found = Vec::new();
                spelled(&u.tree, &[], &mut found);
                let public = offered.offered(&u.vis, &u.attrs);
                module.uses.extend(found.into_iter().map(|(name, path)| (name, path, public)));
            }
            Item::Impl(i) if i.trait_.is_none() => {
                let syn::Type::Path(of) = &*i.self_ty else { continue };
                let of = of.path.segments.iter().map(|s| s.ident.to_string()).collect();
                let member = |m: &ImplItem| match m {
                    ImplItem::Fn(f) if offered.offered(&f.vis, &f.attrs) => Some((f.sig.ident.to_string(), "fn")),
                    ImplItem::Const(c) if offered.offered(&c.vis, &c.attrs) => Some((c.ident.to_string(), "const")),
                    _ => None,
                };
                module.members.push((of, i.items.iter().filter_map(member).collect()));
            }
            other => {
                module.items.extend(named(other, offered));
                let Item::Trait(t) = other else { continue };
                let member = |m: &TraitItem| match m {
                    TraitItem::Fn(f) => Some((f.sig.ident.to_string(), "fn")),
                    TraitItem::Const(c) => Some((c.ident.to_string(), "const")),
                    TraitItem::Type(t) => Some((t.ident.to_string(), "type")),
                    _ => None,
                };
                module.members.push((vec![t.ident.to_string()], t.items.iter().filter_map(member).collect()));
            }
        }
    }
    all.insert(at, module);
}

fn parsed(text: &str, name: &str) -> Vec<Item> {
    syn::parse_file(text).unwrap_or_else(|e| panic!("{name}: {e}")).items
}

/// What `path`, written in the module `at`, stands for: as many as there are, for a name may be a module's and a function's.
fn meant(all: &Modules, at: &Path, path: &[String], depth: usize) -> Vec<Meant> {
    let Some((first, rest)) = path.split_first().filter(|_| depth < 16) else { return Vec::new() };
    let into = |module: Path| match rest {
        [] => module.split_last().map_or_else(Vec::new, |(name, of)| vec![(of.to_vec(), name.clone(), "mod")]),
        rest => meant(all, &module, rest, depth + 1),
    };
    match first.as_str() {
        "crate" => return into(at[..1].to_vec()),
        "self" => return into(at.clone()),
        "super" => return into(at[..at.len() - 1].to_vec()),
        name if all.contains_key(std::slice::from_ref(first)) && !known(all, at, name) => {
            return into(vec![first.clone()]);
        }
        _ => {}
    }
    let Some(module) = all.get(at) else { return Vec::new() };
    let mut found: Vec<Meant> = Vec::new();
    for (name, kind, _) in module.items.iter().filter(|i| i.0 == *first) {
        match (*kind, rest) {
            (_, []) => found.push((at.clone(), name.clone(), kind)),
            ("mod", _) => found.extend(into(at.iter().cloned().chain([name.clone()]).collect())),
            _ => {}
        }
    }
    for (name, path, _) in module.uses.iter().filter(|u| u.0 == *first || u.0 == "*") {
        let whole: Path = if name == "*" { path.iter().chain([first]).cloned().collect() } else { path.clone() };
        found.extend(meant(all, at, &whole.into_iter().chain(rest.to_vec()).collect::<Path>(), depth + 1));
    }
    found
}

/// Whether the module `at` itself has the name.
fn known(all: &Modules, at: &Path, name: &str) -> bool {
    all.get(at).is_some_and(|m| m.items.iter().any(|i| i.0 == name))
}

/// All modules of all crates.
fn modules(offered: Of) -> Modules {
    let mut all = Modules::new();
    for (folder, name) in CRATES {
        let files = sources(folder.trim_end_matches('/'));
        let text = &files[&format!("{folder}lib.rs")];
        read(&parsed(text, name), vec![name.to_owned()], folder, (&files, offered), &mut all);
    }
    all
}

/// The list: lines of items and lines of further paths to them.
fn list(all: &Modules) -> [BTreeSet<String>; 2] {
    // Where each item can be reached from its crate's root.
    let mut reached: BTreeMap<Meant, BTreeSet<(usize, String)>> = BTreeMap::new();
    let mut further = BTreeSet::new();
    let mut open: Vec<Path> = all.keys().filter(|k| k.len() == 1).cloned().collect();
    while let Some(at) = open.pop() {
        let (module, here) = (&all[&at], at.join("::"));
        let mut reach = |meant: Meant, path: String| {
            let length = path.matches("::").count();
            reached.entry(meant).or_default().insert((length, path));
        };
        for (name, kind, _) in module.items.iter().filter(|i| i.2) {
            reach((at.clone(), name.clone(), kind), format!("{here}::{name}"));
            if *kind == "mod" {
                open.push(at.iter().cloned().chain([name.clone()]).collect());
            }
        }
        for (name, path, _) in module.uses.iter().filter(|u| u.2) {
            let of = meant(all, &at, path, 0);
            for target in of.iter().filter(|t| t.0.first() == at.first() && t.2 != "mod") {
                reach(target.clone(), format!("{here}::{name}"));
            }
            if of.iter().all(|t| t.0.first() != at.first() || t.2 == "mod") {
                further.insert(format!("{here}::{name} use {}", path.join("::")));
            }
        }
    }
    let mut items = BTreeSet::new();
    let shortest: BTreeMap<&Meant, &str> =
        reached.iter().filter_map(|(m, paths)| Some((m, paths.first()?.1.as_str()))).collect();
    for ((_, _, kind), paths) in &reached {
        let path = &paths.first().expect("a path").1;
        items.insert(format!("{path} {kind}"));
        let others = paths.iter().skip(1).map(|(_, other)| format!("{other} use {path}"));
        further.extend(others);
    }
    for (at, module) in all {
        for (of, members) in &module.members {
            for target in meant(all, at, of, 0).iter().filter(|t| ["struct", "enum", "trait", "union"].contains(&t.2)) {
                if let Some(path) = shortest.get(target) {
                    items.extend(members.iter().map(|(name, kind)| format!("{path}::{name} {kind}")));
                }
            }
        }
    }
    [items, further]
}

#[test]
fn what_is_offered_is_what_was_recorded() {
    let [items, further] = list(&modules(Of::Shown));
    let shared = list(&modules(Of::All))[0].len() - items.len();
    eprintln!(
        "{} public items, {} further paths to them; {shared} more that the crates share",
        items.len(),
        further.len()
    );
    let text: String = items.iter().chain(&further).map(|line| format!("{line}\n")).collect();
    let file = root().join(LIST);
    if std::env::var_os(RECORD).is_some() {
        std::fs::write(&file, &text).expect("written");
    }
    let recorded = std::fs::read_to_string(&file).expect("the list");
    let [now, before] = [&text, &recorded].map(|t| t.lines().collect::<BTreeSet<_>>());
    let lines = |sign: &str, a: &BTreeSet<&str>, b: &BTreeSet<&str>| {
        a.difference(b).map(|line| format!("{sign} {line}\n")).collect::<String>()
    };
    let changes = format!("{}{}", lines("+", &now, &before), lines("-", &before, &now));
    assert!(
        changes.is_empty(),
        "what the packages offer has changed:\n{changes}Where it is meant to, record it anew:\n    \
         {RECORD}=1 cargo test -p isoplanat-structure public_api"
    );
    let more = "what only the workspace's crates share is `#[doc(hidden)]`";
    assert!(items.len() <= MOST, "{} public items, more than {MOST}: {more}", items.len());
}

/// A small crate: what is reached by a private module's `use`, what is not, members, names of two kinds.
#[test]
fn the_reader_finds_what_can_be_reached() {
    let text = "pub mod a { mod inner { pub struct Kept; impl Kept { pub fn new() {} fn own() {} pub const N: u8 = 1; } pub struct Lost; }
        pub use inner::Kept; pub(crate) fn b() {} #[doc(hidden)] pub fn c() {} pub fn d() {} pub mod d {} }
        #[cfg(test)] mod tests { pub fn no() {} } pub use a::Kept as Other; pub use a::d; pub trait T { fn m(&self); }
        impl a::Kept { pub fn more(&self) {} } pub enum E { V }";
    let mut all = Modules::new();
    read(&parsed(text, "k"), vec!["k".to_owned()], "", (&BTreeMap::new(), Of::Shown), &mut all);
    let [items, further] = list(&all);
    let expected = [
        "k::E enum",
        "k::Other struct",
        "k::Other::N const",
        "k::Other::more fn",
        "k::Other::new fn",
        "k::T trait",
        "k::T::m fn",
        "k::a mod",
        "k::a::d mod",
        "k::d fn",
    ];
    assert_eq!(items.iter().map(String::as_str).collect::<Vec<_>>(), expected);
    assert_eq!(further.iter().map(String::as_str).collect::<Vec<_>>(), ["k::a::Kept use k::Other", "k::a::d use k::d"]);
}
