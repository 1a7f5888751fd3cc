//! `isoplanat view`: the page of a lens or of a run, live: it follows the file.
//!
//! A small server on the loopback interface for whoever has its address (`server`, `answer`, `token`). What is followed (`watch`) is shown on a board, whose
//! news the page hears as a stream of events (`board`, `live.js`). A file that is no lens keeps the last good page, with the error on top. Other pages of the
//! same browser, and other users, can connect as well: none of what they send ends the program, or keeps the page from its user (`door`, `room`, `patience`).

mod answer;
mod board;
mod door;
mod patience;
mod room;
mod server;
mod talk;
mod token;
mod watch;

use std::io::Write;
use std::path::PathBuf;
use std::sync::Arc;

use isoplanat::report::html::SCRIPT;
use isoplanat::report::table::numbered;

use crate::analyses::View;
use crate::named::Named;
use crate::output::Common;
use answer::Desk;
use board::Board;
use server::Server;
use token::Token;
use watch::{Subject, Watch};

/// Arguments of `view`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Lens file (.toml, .zmx, .seq, .json, .txt), the name of a shipped lens, or the folder of a design
    #[arg(value_name = "LENS|RUN")]
    what: Named,
    /// Port on the loopback interface; 0 takes a free one
    #[arg(long, default_value_t = 0)]
    port: u16,
    /// Write the page to a file and end: the same page, without a server
    #[arg(long, value_name = "OUT.html")]
    export: Option<PathBuf>,
    #[command(flatten)]
    view: View,
    #[command(flatten)]
    common: Common,
}

/// Where the page is, for machines.
#[derive(serde::Serialize)]
#[serde(rename_all = "lowercase")]
enum Place<'a> {
    File(String),
    Url(&'a str),
}

/// Runs the command until it is interrupted; where the page is goes to `out`.
pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    let options = args.view.options()?;
    let watch = Watch { subject: Subject::new(&args.what)?, view: args.view.clone(), options };
    if let Some(path) = &args.export {
        crate::output::check_writable(path, args.common.force)?;
        let bar = crate::progress::Bar::new("page");
        let page = watch.page(false)?;
        bar.done(String::new());
        crate::output::put(&page, Some(path), args.common.force, out)?;
        if args.common.json {
            writeln!(out, "{}", numbered(&Place::File(path.display().to_string())))?;
        }
        return Ok(());
    }
    // A first page, or the reason why there is none, before anything is served.
    let first = watch.page(true)?;
    if !first.contains(SCRIPT) {
        crate::aside!(
            "note: {}: of another version of this program: its script does not run here; a browser runs it from the file itself",
            args.what
        );
    }
    let board = Arc::new(Board::new(&first));
    let server = Server::new(args.port)?;
    let desk = Desk::new(server.address(), Token::new()?, Arc::clone(&board))?;
    let url = desk.url();
    if args.common.json {
        writeln!(out, "{}", numbered(&Place::Url(&url)))?;
    } else {
        writeln!(out, "{url}")?;
    }
    out.flush()?;
    watch.start(&board)?;
    Ok(server.run(desk)?)
}
