//! `isoplanat slanted-edge IMAGE`: the MTF that a picture of a slanted edge shows, channel by channel.

mod listing;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use isoplanat::error::Location;
use isoplanat::imaging::files::Encoding;
use isoplanat::imaging::metrics::slanted_edge::{EdgeOptions, Rectangle, find_region, measure};
use isoplanat::imaging::sensor::cfa::Cfa;
use isoplanat::math::memory::product;
use isoplanat::{Error, Result};

use crate::output::Common;
use crate::picture;
use listing::{Listing, Measured};

/// What the numbers of an integer picture stand for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Coding {
    /// Proportional to light
    Linear,
    /// sRGB
    Srgb,
}

/// Arguments of `slanted-edge`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Picture (.png, .tif, .jpg, .npy) of one slanted edge, or RAW file (.dng, .nef, .arw …; needs the feature `deploy`)
    image: PathBuf,
    /// Where the edge is: column and row of the first pixel, width, height [default: the largest part with one straight edge]
    #[arg(long, value_name = "X,Y,W,H", allow_hyphen_values = true)]
    region: Option<String>,
    /// What the numbers stand for [default: as the file says (profile, sRGB or gAMA chunk), else sRGB for 8 bits and linear for more; floating point is linear]
    #[arg(long, value_enum)]
    encoding: Option<Coding>,
    /// The picture is a mosaic behind this Bayer filter: RGGB, GRBG, GBRG, BGGR
    #[arg(long, value_name = "LAYOUT")]
    cfa: Option<String>,
    /// Channel whose figures stand first: grey, R, G, B, luminance [default: grey, or G]
    #[arg(long)]
    channel: Option<String>,
    /// MTF and edge spread function, drawn
    #[arg(long, value_name = "OUT.svg")]
    svg: Option<PathBuf>,
    /// The MTF of every channel as comma-separated values
    #[arg(long, value_name = "OUT.csv")]
    csv: Option<PathBuf>,
    #[command(flatten)]
    common: Common,
}

/// Pixels from which a search for an edge takes more than a moment.
const LARGE: usize = 50_000_000;

/// Bytes of a pixel while an edge is looked for: its value, means of cells and how far they are from their neighbours.
const LOOKED_THROUGH: usize = 5 * size_of::<f64>();

/// Runs the command; the result goes to `out`.
pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    crate::output::check_all(&[args.svg.as_deref(), args.csv.as_deref()], args.common.force)?;
    let region = args.region.as_deref().map(rectangle).transpose()?;
    let cfa = args.cfa.as_deref().map(layout).transpose()?;
    let encoding = args.encoding.map(|c| match c {
        Coding::Linear => Encoding::Linear,
        Coding::Srgb => Encoding::Srgb,
    });
    let picture = picture::read(&args.image, encoding, cfa, picture::Way::Seen)?;
    let names: Vec<&str> = picture.channels.iter().map(|c| c.name).collect();
    let first = match &args.channel {
        None => names.iter().position(|n| *n == "G").unwrap_or(0),
        Some(name) => names.iter().position(|n| n.eq_ignore_ascii_case(name)).ok_or_else(|| {
            Error::bad("--channel", "value", name.as_str(), format!("this picture has {}", names.join(", ")))
        })?,
    };
    let place = args.image.as_path();
    // One region for all channels, found in the first.
    let sought = &picture.channels[first];
    let region = match region {
        Some(region) => region,
        None => {
            let (rows, columns) = sought.plane.dim();
            let bytes = product(&[rows, columns, LOOKED_THROUGH]);
            let what = format!("{}: an edge sought in {columns} × {rows} pixels", place.display());
            crate::memory::limit().allow(&what, bytes, "--region x,y,w,h")?;
            let _bar = (rows * columns > LARGE).then(|| crate::progress::Bar::new("edge"));
            find_region(sought.plane.view(), sought.sites).map_err(|e| in_channel(e, sought.name, place))?
        }
    };
    let (mut measured, mut refused) = (Vec::new(), Vec::new());
    for (k, channel) in picture.channels.iter().enumerate() {
        let options = EdgeOptions { region: Some(region), sites: channel.sites, range: channel.range };
        match measure(channel.plane.view(), &options) {
            Ok(edge) => measured.push(Measured { name: channel.name, edge }),
            Err(e) if k == first => return Err(in_channel(e, channel.name, place).into()),
            Err(e) => refused.push((channel.name, in_channel(e, channel.name, place).to_string())),
        }
    }
    let first = measured.iter().position(|m| m.name == names[first]).unwrap_or(0);
    refused.iter().for_each(|(_, why)| crate::tell!("warning: {why}"));
    let image = args.image.display().to_string();
    let listing = Listing { first, measured, refused, source: picture.source, image };
    if let Some(path) = &args.csv {
        crate::output::put(&listing.csv(), Some(path), args.common.force, out)?;
    }
    if let Some(path) = &args.svg {
        crate::output::put(&listing.svg(), Some(path), args.common.force, out)?;
    }
    if args.common.json {
        writeln!(out, "{:#}", listing.json())?;
    } else {
        write!(out, "{listing}")?;
    }
    for (name, warning) in listing.warnings() {
        crate::tell!("warning: {}: {name}: {warning}", listing.image);
    }
    Ok(())
}

/// The same error with the channel of the picture it concerns.
fn in_channel(error: Error, name: &str, picture: &Path) -> Error {
    error.within(Location::called(format!("channel {name}"))).in_file(picture)
}

/// The rectangle `x,y,w,h`.
fn rectangle(text: &str) -> Result<Rectangle> {
    let numbers: Vec<Option<usize>> = text.split(',').map(|v| usize::from_str(v.trim()).ok()).collect();
    match numbers[..] {
        [Some(x), Some(y), Some(width), Some(height)] => Ok(Rectangle { x, y, width, height }),
        _ => Err(Error::bad("--region", "value", text, "x,y,w,h: four whole numbers of pixels, none negative")),
    }
}

fn layout(text: &str) -> Result<Cfa> {
    Cfa::from_name(text).ok_or_else(|| Error::bad("--cfa", "value", text, "RGGB, GRBG, GBRG or BGGR"))
}
