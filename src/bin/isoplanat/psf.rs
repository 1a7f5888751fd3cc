//! `isoplanat psf`: kernels over depth, field and wavelength as `.npz`, and as one picture.

use std::io::Write;
use std::path::{Path, PathBuf};

use isoplanat::imaging::files::{write_atomic, write_png8};
use isoplanat::lens::Lens;
use isoplanat::math::memory::words;
use isoplanat::report::atlas;
use isoplanat::report::table::{Table, significant};
use isoplanat::{Error, Result};
use ndarray::ArrayView1;
use ndarray_npy::NpzWriter;

/// Arguments of `psf`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Lens file (TOML), or the name of a shipped lens
    lens: String,
    /// Where to put the kernels (NumPy `.npz`)
    #[arg(short, long, value_name = "OUT.npz")]
    output: PathBuf,
    /// Also draw them: one row a depth, one column a field, in the colours of the generic sensor
    #[arg(long, value_name = "OUT.png")]
    png: Option<PathBuf>,
    /// Object distances before the first surface, mm, comma separated; `inf` is allowed [default: the lens's own]
    #[arg(long, value_delimiter = ',', allow_negative_numbers = true, value_name = "MM")]
    depth_mm: Vec<f64>,
    /// Wavelengths, nm, comma separated [default: the lens's own]
    #[arg(long, value_delimiter = ',', allow_negative_numbers = true, value_name = "NM")]
    wavelength_nm: Vec<f64>,
    /// Field points from the axis to the border
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u16).range(1..=512))]
    fields: u16,
    /// Kernel size, pixels, odd [default: what holds 99.9 % of the light]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=2047))]
    size: Option<u16>,
    /// Pixel pitch, µm [default: the lens's sensor]
    #[arg(long, allow_negative_numbers = true, value_name = "UM")]
    pitch_um: Option<f64>,
    /// Rays per kernel and wavelength
    #[arg(long, default_value_t = 16384, value_parser = clap::value_parser!(u32).range(16..=1_000_000))]
    rays: u32,
    /// Overwrite outputs
    #[arg(long)]
    force: bool,
}

/// Runs the command; a summary goes to `out`.
pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    for path in std::iter::once(&args.output).chain(&args.png) {
        crate::output::check_writable(path, args.force)?;
    }
    let lens = crate::input::lens(&args.lens)?;
    let request = request(args, &lens)?;
    let in_lens = |e: Error| crate::input::in_lens(e, &lens, &args.lens).in_file(Path::new(&args.lens));
    let kernels = atlas::KernelSet::compute(&lens, &request).map_err(in_lens)?;
    save(&kernels, &args.output)?;
    if let Some(path) = &args.png {
        let columns = kernels.request.fields;
        let colours = atlas::colour_kernels(&lens, &request).map_err(in_lens)?;
        write_png8(path, &atlas::picture(&colours, columns, atlas::Style::default()))?;
    }
    let mut table = Table::new(["depth/mm", "field/deg", "sensor radius/mm", "relative illumination", "outside/%"]);
    for (d, depth) in request.depth_mm.iter().enumerate() {
        for f in 0..kernels.request.fields {
            let lost = kernels.outside.slice(ndarray::s![d, f, ..]).fold(0.0, |m: f64, x| m.max(*x));
            table.row([
                significant(*depth, 6),
                format!("{:.3}", kernels.angle_deg[[d, f]]),
                format!("{:.4}", kernels.radius_mm[[d, f]]),
                format!("{:.4}", kernels.relative_illumination[[d, f, 0]]),
                format!("{:.3}", 100.0 * lost),
            ]);
        }
    }
    write!(out, "{table}")?;
    let (size, nm) = (kernels.kernels.len_of(ndarray::Axis(3)), request.wavelength_nm.len());
    writeln!(out, "{size} × {size} pixels of {} µm, {nm} wavelengths", significant(request.pitch_mm * 1e3, 6))?;
    let kernels = request.depth_mm.len() * kernels.request.fields;
    let drawn = if args.png.is_some() { 4 * atlas::bytes(kernels, 3, size) } else { 0 };
    writeln!(out, "memory: at most {}", words(atlas::bytes(kernels, nm, size) + drawn))?;
    Ok(())
}

/// The checked request.
fn request(args: &Args, lens: &Lens) -> Result<atlas::KernelRequest> {
    let own = |given: &[f64], own: Vec<f64>| if given.is_empty() { own } else { given.to_vec() };
    let depth_mm = own(&args.depth_mm, vec![1.0 / lens.object_vergence]);
    if let Some(d) = depth_mm.iter().find(|d| d.is_nan() || **d <= 0.0) {
        return Err(Error::bad("--depth-mm", "value", d.to_string(), "positive distances, or inf"));
    }
    let wavelength_nm = own(&args.wavelength_nm, lens.wavelengths.nm.clone());
    if let Some(nm) = wavelength_nm.iter().find(|nm| !(200.0..=20_000.0).contains(*nm)) {
        return Err(Error::bad("--wavelength-nm", "value", nm.to_string(), "200 to 20000 nm"));
    }
    let pitch_um = args.pitch_um.unwrap_or(lens.sensor.pitch_um);
    if !(pitch_um.is_finite() && pitch_um > 0.0) {
        return Err(Error::bad("--pitch-um", "value", pitch_um.to_string(), "a positive number of µm"));
    }
    if let Some(size) = args.size.filter(|s| s % 2 == 0) {
        return Err(Error::bad("--size", "value", size.to_string(), "an odd number of pixels"));
    }
    Ok(atlas::KernelRequest {
        depth_mm,
        wavelength_nm,
        fields: usize::from(args.fields),
        size: args.size.map(usize::from),
        pitch_mm: pitch_um * 1e-3,
        rays: args.rays as usize,
        memory: crate::memory::limit(),
    })
}

/// Writes every array of `set` under its name.
fn save(set: &atlas::KernelSet, path: &Path) -> Result<()> {
    let failed = |e: ndarray_npy::WriteNpzError| Error::writing(path, std::io::Error::other(e));
    let meta = &set.request;
    write_atomic(path, |file| {
        let mut npz = NpzWriter::new(file);
        npz.add_array("kernels", &set.kernels).map_err(failed)?;
        for (name, array) in [("relative_illumination", &set.relative_illumination), ("outside", &set.outside)] {
            npz.add_array(name, array).map_err(failed)?;
        }
        let places =
            [("sensor_radius_mm", &set.radius_mm), ("object_slope", &set.slope), ("field_angle_deg", &set.angle_deg)];
        for (name, array) in places {
            npz.add_array(name, array).map_err(failed)?;
        }
        for (name, values) in [("depth_mm", &meta.depth_mm), ("wavelength_nm", &meta.wavelength_nm)] {
            npz.add_array(name, &ArrayView1::from(values)).map_err(failed)?;
        }
        npz.add_array("pitch_mm", &ndarray::arr0(meta.pitch_mm)).map_err(failed)?;
        npz.add_array("schema", &ndarray::arr0(1_i64)).map_err(failed)?;
        npz.finish().map(drop).map_err(failed)
    })
}
