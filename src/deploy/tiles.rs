//! A picture through the network in overlapping tiles: fixed memory, and the same result as in one piece.
//!
//! The picture is mirrored outwards at its border. A tile's outer `overlap` pixels are thrown away, so that each pixel
//! kept has all it depends on within its tile; tiles start at multiples of the network's pooling step, so that its
//! coarse rasters lie alike in all of them.

use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use ndarray::parallel::prelude::*;
use ndarray::{Array3, Array4, ArrayView3, ArrayView4, s};

use crate::error::{Error, Result};

/// Size of the tiles, pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tiling {
    tile: usize,
    overlap: usize,
    core: usize,
}

impl Tiling {
    /// Tiles of `tile × tile` pixels that throw `overlap` pixels away on each side; sizes and starts are multiples of
    /// `multiple`. The overlap should be the network's receptive radius.
    ///
    /// # Errors
    /// A tile that is not a multiple of `multiple`, is above 8192, or keeps nothing between its overlaps.
    pub fn new(tile: usize, overlap: usize, multiple: usize) -> Result<Self> {
        if !(1..=1024).contains(&multiple) {
            return Err(Error::bad("", "multiple", multiple.to_string(), "1 to 1024 pixels"));
        }
        if tile == 0 || !tile.is_multiple_of(multiple) || tile > 8192 {
            let allowed = format!("a multiple of {multiple} up to 8192");
            return Err(Error::bad("", "tile_px", tile.to_string(), allowed));
        }
        let core = tile.saturating_sub(overlap.saturating_mul(2)) / multiple * multiple;
        if core == 0 {
            let found = format!("{overlap} of a tile of {tile}");
            return Err(Error::bad("", "overlap_px", found, "less than half a tile, with a multiple left between"));
        }
        Ok(Self { tile, overlap, core })
    }

    /// Side of a tile.
    pub fn tile(self) -> usize {
        self.tile
    }

    /// Number of tiles for a picture of `rows × columns`.
    pub fn count(self, rows: usize, columns: usize) -> usize {
        rows.div_ceil(self.core) * columns.div_ceil(self.core)
    }

    /// Share of the network's work that is kept, for a large picture.
    pub fn efficiency(self) -> f64 {
        (self.core as f64 / self.tile as f64).powi(2)
    }
}

/// Runs `image` (`[3, row, col]`) through `network`, which maps `[1, 3, tile, tile]` to the same shape.
///
/// At most `parallel` tiles are in work at a time. `progress(done, all)` is called after each.
///
/// # Errors
/// The network's first error, or an output of another shape.
pub fn run(
    image: ArrayView3<'_, f32>,
    tiling: Tiling,
    parallel: usize,
    network: &(dyn Fn(ArrayView4<'_, f32>) -> Result<Array4<f32>> + Sync),
    progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<Array3<f32>> {
    let (channels, rows, columns) = image.dim();
    let starts = |n: usize| (0..n).step_by(tiling.core);
    let places: Vec<(usize, usize)> = starts(rows).flat_map(|r| starts(columns).map(move |c| (r, c))).collect();
    let out = Mutex::new(Array3::zeros((channels, rows, columns)));
    let done = AtomicUsize::new(0);
    let one = |&(row, column): &(usize, usize)| -> Result<()> {
        let input = cut(image, tiling, row, column);
        let output = network(input.view())?;
        if output.dim() != input.dim() {
            let found = format!("an output of {:?} for an input of {:?}", output.dim(), input.dim());
            return Err(Error::bad("", "network", found, "the same shape"));
        }
        let (height, width) = ((rows - row).min(tiling.core), (columns - column).min(tiling.core));
        let kept =
            output.slice(s![0, .., tiling.overlap..tiling.overlap + height, tiling.overlap..tiling.overlap + width]);
        let mut out = out.lock().map_err(|_| Error::Internal("a tile's worker failed".into()))?;
        out.slice_mut(s![.., row..row + height, column..column + width]).assign(&kept);
        drop(out);
        progress(done.fetch_add(1, Ordering::Relaxed) + 1, places.len());
        Ok(())
    };
    if parallel <= 1 {
        places.iter().try_for_each(one)?;
    } else {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(parallel).build();
        let pool = pool.map_err(|e| Error::Internal(format!("threads for the tiles: {e}")))?;
        pool.install(|| places.par_iter().with_max_len(1).try_for_each(one))?;
    }
    out.into_inner().map_err(|_| Error::Internal("a tile's worker failed".into()))
}

/// The tile whose kept part starts at `row`, `column`, mirrored where it leaves the picture.
fn cut(image: ArrayView3<'_, f32>, tiling: Tiling, row: usize, column: usize) -> Array4<f32> {
    let (channels, rows, columns) = image.dim();
    let sources = |start: usize, n: usize| -> Vec<usize> {
        (0..tiling.tile).map(|k| mirrored(start as i64 + k as i64 - tiling.overlap as i64, n)).collect()
    };
    let (across, down) = (sources(column, columns), sources(row, rows));
    // Most tiles lie within the picture's columns: their rows are copied as they are.
    let straight = across.windows(2).all(|w| w[1] == w[0] + 1).then(|| across[0]..across[0] + tiling.tile);
    let mut tile = Array4::zeros((1, channels, tiling.tile, tiling.tile));
    for c in 0..channels {
        for (i, &r) in down.iter().enumerate() {
            let line = image.slice(s![c, r, ..]);
            let mut into = tile.slice_mut(s![0, c, i, ..]);
            match &straight {
                Some(range) => into.assign(&line.slice(s![range.clone()])),
                None => into.iter_mut().zip(&across).for_each(|(v, &q)| *v = line[q]),
            }
        }
    }
    tile
}

/// Index `i` mirrored into `0..n` about the first and last sample, which are not repeated.
fn mirrored(i: i64, n: usize) -> usize {
    let last = n as i64 - 1;
    if last <= 0 {
        return 0;
    }
    let folded = i.rem_euclid(2 * last);
    folded.min(2 * last - folded) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A stand-in network of radius 3 that also knows its place on a raster of 4: mean of 7×7 plus the mean of its
    /// 4×4 cell, zero outside the tile, as convolutions pad.
    fn network(input: ArrayView4<'_, f32>) -> Result<Array4<f32>> {
        let (_, channels, rows, columns) = input.dim();
        Ok(Array4::from_shape_fn((1, channels, rows, columns), |(_, c, i, j)| {
            let mut sum = 0.0;
            for r in i.saturating_sub(3)..(i + 4).min(rows) {
                for q in j.saturating_sub(3)..(j + 4).min(columns) {
                    sum += input[[0, c, r, q]];
                }
            }
            let (r, q) = (i / 4 * 4, j / 4 * 4);
            sum / 49.0 + input.slice(s![0, c, r..r + 4, q..q + 4]).sum() / 16.0
        }))
    }

    fn picture(rows: usize, columns: usize) -> Array3<f32> {
        let rng = &mut fastrand::Rng::with_seed(7);
        Array3::from_shape_fn((3, rows, columns), |_| rng.f32())
    }

    /// The whole picture in one tile large enough for it.
    fn whole(image: &Array3<f32>, overlap: usize) -> Array3<f32> {
        run(image.view(), Tiling::new(256, overlap, 4).expect("valid"), 1, &network, &|_, _| ()).expect("runs")
    }

    #[test]
    fn tiles_give_what_the_whole_picture_gives() {
        for (rows, columns) in [(50, 70), (24, 24), (1, 5), (97, 33)] {
            let image = picture(rows, columns);
            let reference = whole(&image, 4);
            for parallel in [1, 3] {
                let tiling = Tiling::new(32, 4, 4).expect("valid");
                let calls = AtomicUsize::new(0);
                let tiled = run(image.view(), tiling, parallel, &network, &|_, all| {
                    calls.fetch_add(1, Ordering::Relaxed);
                    assert_eq!(all, tiling.count(rows, columns));
                })
                .expect("runs");
                assert_eq!(calls.into_inner(), tiling.count(rows, columns));
                let worst = (&tiled - &reference).iter().fold(0.0_f32, |m, v| m.max(v.abs()));
                assert!(worst <= 1e-6, "{rows}×{columns}: {worst}");
            }
        }
    }

    #[test]
    fn a_u_net_in_tiles_gives_what_it_gives_in_one_piece() {
        use crate::deploy::session::{Choice, Options, Session};
        use crate::deploy::test_model::{UNET_RADIUS, unet};
        let options = Options { choice: Choice::Tract, threads: 2, ..Options::default() };
        let session = Session::open(&unet(4, 9, &[]), std::path::Path::new("model.onnx"), &options).expect("opens");
        let network = |tile: ArrayView4<'_, f32>| session.run(tile);
        let image = picture(100, 130);
        let through = |tile: usize| {
            let tiling = Tiling::new(tile, UNET_RADIUS, 4).expect("valid");
            run(image.view(), tiling, session.parallel_tiles(), &network, &|_, _| ()).expect("runs")
        };
        let worst = (&through(96) - &through(192)).iter().fold(0.0_f32, |m, v| m.max(v.abs()));
        assert!(worst <= 1e-6, "{worst}");
    }

    #[test]
    fn mirroring_does_not_repeat_the_border() {
        let row: Vec<usize> = (-4..9).map(|i| mirrored(i, 4)).collect();
        assert_eq!(row, [2, 3, 2, 1, 0, 1, 2, 3, 2, 1, 0, 1, 2]);
        assert_eq!(mirrored(-9, 1), 0);
    }

    #[test]
    fn tilings_that_keep_nothing_are_refused() {
        assert!(Tiling::new(64, 32, 4).is_err() && Tiling::new(64, 31, 4).is_err() && Tiling::new(66, 4, 4).is_err());
        assert!(Tiling::new(0, 0, 4).is_err() && Tiling::new(64, 4, 0).is_err() && Tiling::new(1 << 20, 4, 4).is_err());
        assert!((Tiling::new(512, 48, 4).expect("valid").efficiency() - (416.0_f64 / 512.0).powi(2)).abs() < 1e-12);
    }

    #[test]
    fn a_failing_network_and_a_wrong_shape_are_errors() {
        let image = picture(20, 20);
        let tiling = Tiling::new(16, 4, 4).expect("valid");
        for parallel in [1, 4] {
            let fails = |_: ArrayView4<'_, f32>| Err(Error::Internal("no".into()));
            assert!(run(image.view(), tiling, parallel, &fails, &|_, _| ()).is_err());
            let shrinks = |_: ArrayView4<'_, f32>| Ok(Array4::zeros((1, 3, 8, 8)));
            assert!(run(image.view(), tiling, parallel, &shrinks, &|_, _| ()).is_err());
        }
    }
}
