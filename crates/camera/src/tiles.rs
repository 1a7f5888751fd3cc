//! A picture through the network in overlapping tiles: bounded memory, and the same result as in one piece.
//!
//! The picture is mirrored outwards at its border, by the overlap but at most `BORDER` pixels, and to the network's next
//! multiple. A tile's outer `overlap` pixels are thrown away where another tile has them, so that each pixel kept has all it
//! depends on within its tile; all tiles of a picture have one shape and start at multiples of the network's pooling step, so
//! that its coarse rasters lie alike in all of them. A picture smaller than a tile is one smaller tile.

use std::collections::BTreeSet;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError, RwLock};

use ndarray::{Array3, Array4, ArrayView3, ArrayView4, s};

use super::lock;
use isoplanat_base::error::{Error, Result};
use isoplanat_imaging::guide::Guide;
use isoplanat_imaging::plane::{Region, mirrored};

/// Most pixels a picture is mirrored outwards by: beyond, a network sees zeros as it did beyond its training patches.
pub(crate) const BORDER: usize = 64;

/// Size of the tiles, pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tiling {
    tile: usize,
    overlap: usize,
    core: usize,
    multiple: usize,
}

/// One tile along one axis, in rows or columns of the continued picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Span {
    /// Where the tile starts.
    start: usize,
    /// What is kept of it: from, to.
    kept: [usize; 2],
}

impl Tiling {
    /// Tiles of at most `tile × tile` pixels that throw `overlap` pixels away on each side; sizes and starts are multiples of
    /// `multiple`. The overlap should be the network's receptive radius.
    ///
    /// ```
    /// use isoplanat_camera::tiles::Tiling;
    ///
    /// let tiling = Tiling::new(320, 40, 4)?;
    /// assert_eq!((tiling.count(100, 200), tiling.shape(2000, 3000)), (1, [320, 320]));
    /// assert!(Tiling::new(64, 32, 4).is_err(), "nothing would be kept");
    /// # Ok::<(), isoplanat_base::error::Error>(())
    /// ```
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
        Ok(Self { tile, overlap, core, multiple })
    }

    /// Side of a tile.
    pub(crate) fn tile(self) -> usize {
        self.tile
    }

    /// Rows and columns of every tile of a picture of `rows × columns`.
    pub fn shape(self, rows: usize, columns: usize) -> [usize; 2] {
        [rows, columns].map(|n| self.continued(n).min(self.tile))
    }

    /// Number of tiles for a picture of `rows × columns`.
    pub fn count(self, rows: usize, columns: usize) -> usize {
        self.spans(rows).len() * self.spans(columns).len()
    }

    /// Share of the network's work that is kept, for a large picture.
    pub(crate) fn efficiency(self) -> f64 {
        (self.core as f64 / self.tile as f64).powi(2)
    }

    /// Pixels the picture is mirrored by before its first row and column.
    fn border(self) -> usize {
        self.overlap.min(BORDER.next_multiple_of(self.multiple))
    }

    /// Length of the continued picture along an axis of `n` pixels.
    fn continued(self, n: usize) -> usize {
        (n + 2 * self.border()).next_multiple_of(self.multiple)
    }

    /// The picture's rows or columns, `n` in all, under `side` pixels from `start` on of the continued picture.
    fn sources(self, start: usize, side: usize, n: usize) -> Vec<usize> {
        let border = self.border().cast_signed();
        (0..side).map(|k| mirrored((start + k).cast_signed() - border, n)).collect()
    }

    /// The tiles along an axis of `n` pixels; what they keep covers the picture once.
    fn spans(self, n: usize) -> Vec<Span> {
        let (all, first) = (self.continued(n), self.border());
        let side = all.min(self.tile);
        let (mut spans, mut from) = (Vec::new(), first);
        for start in (0..).step_by(self.core).map(|s| s.min(all - side)) {
            let last = start + side == all;
            let to = if last { first + n } else { (start + side - self.overlap).min(first + n) };
            if to > from {
                spans.push(Span { start, kept: [from, to] });
                from = to;
            }
            if last || from == first + n {
                break;
            }
        }
        spans
    }
}

/// Runs `image` (`[3, row, col]`), which lies at `at` of the guide's frame, through `network`, which maps what `guide` shows of a tile,
/// `[1, channel, rows, columns]` of [`Tiling::shape`], to `[1, 3, rows, columns]`. What is kept of a tile takes the picture's place as soon as no tile
/// that is still to be cut reads it: beside the picture stand about a row of tiles, and those in work.
///
/// A part of a frame that starts at multiples of the tiling's is what it is within the whole, further than the overlap and the guide's reach from
/// those of its borders that are not the frame's.
///
/// At most `parallel` tiles are in work at a time. `progress(done, all)` is called after each.
///
/// # Errors
/// The network's first error, or an output of another shape, or of values that are no numbers.
pub fn run(
    image: Array3<f32>,
    at: Region,
    guide: &Guide,
    tiling: Tiling,
    parallel: usize,
    network: &(dyn Fn(ArrayView4<'_, f32>) -> Result<Array4<f32>> + Sync),
    progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<Array3<f32>> {
    let (_, rows, columns) = image.dim();
    let (down, across) = (tiling.spans(rows), tiling.spans(columns));
    let (border, all, done) = (tiling.border(), down.len() * across.len(), AtomicUsize::new(0));
    let one = |(row, column): (Span, Span), input: Array4<f32>| -> Result<Kept> {
        let output = network(input.view())?;
        let (_, _, height, width) = input.dim();
        if output.dim() != (1, 3, height, width) {
            let found = format!("an output of {:?} for an input of {:?}", output.dim(), input.dim());
            return Err(Error::bad("", "network", found, "a network that makes three channels of the same shape"));
        }
        let to = [row, column].map(|span| span.kept[0] - border);
        if let Some(bad) = output.iter().find(|v| !v.is_finite()) {
            let found = format!("{bad} in the tile at row {}, column {}", to[0], to[1]);
            return Err(Error::bad("", "network", found, "a network that makes finite numbers of a picture"));
        }
        let within = |span: Span| span.kept[0] - span.start..span.kept[1] - span.start;
        let part = output.slice(s![0, .., within(row), within(column)]).to_owned();
        progress(done.fetch_add(1, Ordering::Relaxed) + 1, all);
        Ok(Kept { to, part })
    };
    // Before which row nothing is read any more when the rows of tiles before this one are cut.
    let mut needed = vec![rows; down.len() + 1];
    for (k, span) in down.iter().enumerate().rev() {
        let first = tiling.sources(span.start, tiling.shape(rows, columns)[0], rows).into_iter().min().unwrap_or(0);
        needed[k] = needed[k + 1].min(first.saturating_sub(guide.reach()));
    }
    let places: Vec<(Span, Span)> = down.iter().flat_map(|r| across.iter().map(move |c| (*r, *c))).collect();
    let picture = RwLock::new(image);
    let way = Mutex::new(Way::default());
    // Tiles are taken in order, by threads of their own: those that wait for a runtime do not keep anybody from cutting the next.
    let work = || {
        loop {
            let k = {
                let mut way = lock(&way);
                let k = way.next;
                if way.failed.is_some() || k == places.len() {
                    return;
                }
                way.next += 1;
                way.cutting.insert(k);
                k
            };
            let (row, column) = places[k];
            let input = {
                let picture = picture.read().unwrap_or_else(PoisonError::into_inner);
                cut(picture.view(), at, guide, tiling, [row.start, column.start])
            };
            let free = {
                let mut way = lock(&way);
                way.cutting.remove(&k);
                let uncut = way.cutting.first().copied().unwrap_or(way.next);
                way.free(needed[uncut / across.len()])
            };
            put(&picture, free);
            let kept = one((row, column), input);
            let mut way = lock(&way);
            match kept {
                Ok(kept) => way.waiting.push(kept),
                Err(error) => way.failed = way.failed.take().or(Some(error)),
            }
        }
    };
    if parallel <= 1 {
        work();
    } else {
        std::thread::scope(|scope| {
            // Where the system lets fewer be started, those do the work, and this one where there is none.
            let started = |_: &usize| std::thread::Builder::new().spawn_scoped(scope, work).is_ok();
            if (0..parallel.min(places.len())).filter(started).count() == 0 {
                work();
            }
        });
    }
    let way = way.into_inner().unwrap_or_else(PoisonError::into_inner);
    if let Some(error) = way.failed {
        return Err(error);
    }
    put(&picture, way.waiting);
    Ok(picture.into_inner().unwrap_or_else(PoisonError::into_inner))
}

/// Tiles on their way.
#[derive(Default)]
struct Way {
    /// The next to be taken, and those that are being cut.
    next: usize,
    cutting: BTreeSet<usize>,
    /// Done, and their place still read.
    waiting: Vec<Kept>,
    failed: Option<Error>,
}

impl Way {
    /// What lies before `row` of what waits.
    fn free(&mut self, row: usize) -> Vec<Kept> {
        self.waiting.extract_if(.., |w| w.to[0] + w.part.dim().1 <= row).collect()
    }
}

/// Writes parts into the picture.
fn put(picture: &RwLock<Array3<f32>>, parts: Vec<Kept>) {
    if parts.is_empty() {
        return;
    }
    let mut picture = picture.write().unwrap_or_else(PoisonError::into_inner);
    for Kept { to: [row, column], part } in parts {
        let (_, height, width) = part.dim();
        picture.slice_mut(s![.., row..row + height, column..column + width]).assign(&part);
    }
}

/// What is kept of a tile, `[3, row, col]`, and where in the picture it belongs: first row and column.
struct Kept {
    to: [usize; 2],
    part: Array3<f32>,
}

/// What the guide shows of the tile that starts at `row`, `column` of the continued picture. It is told of the pixels that the picture
/// has, and mirrored with them.
fn cut(
    image: ArrayView3<'_, f32>,
    at: Region,
    guide: &Guide,
    tiling: Tiling,
    [row, column]: [usize; 2],
) -> Array4<f32> {
    let (_, rows, columns) = image.dim();
    let [height, width] = tiling.shape(rows, columns);
    let (across, down) = (tiling.sources(column, width, columns), tiling.sources(row, height, rows));
    let span = |places: &[usize]| {
        let (first, last) = places.iter().fold((usize::MAX, 0), |(a, b), p| (a.min(*p), b.max(*p)));
        (first, last + 1 - first)
    };
    let ((top, high), (left, wide)) = (span(&down), span(&across));
    let wanted = Region { row: at.row + top.cast_signed(), col: at.col + left.cast_signed(), rows: high, cols: wide };
    let image = guide.over(image, at, wanted);
    let (down, across) =
        (down.iter().map(|r| r - top).collect::<Vec<_>>(), across.iter().map(|c| c - left).collect::<Vec<_>>());
    // Most tiles lie within the picture's columns: their rows are copied as they are.
    let straight = across.windows(2).all(|w| w[1] == w[0] + 1).then(|| across[0]..across[0] + width);
    let channels = image.dim().0;
    let mut tile = Array4::zeros((1, channels, height, width));
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

    fn bare() -> Guide {
        Guide::bare(&isoplanat_imaging::frame::Frame::centred(64, 48, 0.01).expect("valid"))
    }

    fn picture(rows: usize, columns: usize) -> Array3<f32> {
        let rng = &mut fastrand::Rng::with_seed(7);
        Array3::from_shape_fn((3, rows, columns), |_| rng.f32())
    }

    fn all(image: &Array3<f32>) -> Region {
        Region { row: 0, col: 0, rows: image.dim().1, cols: image.dim().2 }
    }

    /// The whole picture in one tile large enough for it.
    fn whole(image: &Array3<f32>, overlap: usize) -> Array3<f32> {
        run(image.clone(), all(image), &bare(), Tiling::new(256, overlap, 4).expect("valid"), 1, &network, &|_, _| ())
            .expect("runs")
    }

    #[test]
    fn tiles_give_what_the_whole_picture_gives() {
        for (rows, columns) in [(50, 70), (24, 24), (1, 5), (97, 33)] {
            let image = picture(rows, columns);
            let reference = whole(&image, 4);
            for parallel in [1, 3] {
                let tiling = Tiling::new(32, 4, 4).expect("valid");
                let calls = AtomicUsize::new(0);
                let tiled = run(image.clone(), all(&image), &bare(), tiling, parallel, &network, &|_, all| {
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
        use crate::session::{Choice, Options, Session};
        use crate::test_model::{UNET_RADIUS, unet};
        let options = Options { choice: Choice::Tract, threads: 2, ..Options::default() };
        let session = Session::open(&unet(4, 9, &[]), std::path::Path::new("model.onnx"), &options).expect("opens");
        let network = |tile: ArrayView4<'_, f32>| session.run(tile);
        let image = picture(100, 130);
        let through = |tile: usize| {
            let tiling = Tiling::new(tile, UNET_RADIUS, 4).expect("valid");
            run(image.clone(), all(&image), &bare(), tiling, session.parallel_tiles(), &network, &|_, _| ())
                .expect("runs")
        };
        let worst = (&through(96) - &through(192)).iter().fold(0.0_f32, |m, v| m.max(v.abs()));
        assert!(worst <= 1e-6, "{worst}");
    }

    /// Along an axis: one shape, starts at multiples, kept parts that cover the picture once and stand clear of every edge
    /// that is not the continued picture's own.
    #[test]
    fn spans_cover_the_picture_once_and_stand_clear_of_the_edges() {
        for (tile, overlap, multiple) in
            [(32, 4, 4), (96, 24, 4), (1344, 448, 64), (960, 448, 64), (64, 31, 2), (8, 2, 1)]
        {
            let tiling = Tiling::new(tile, overlap, multiple).expect("valid");
            for n in [1, 2, 5, 63, 64, 65, 447, 512, 1279, 1280, 1281, 3000] {
                let (all, border, spans) = (tiling.continued(n), tiling.border(), tiling.spans(n));
                let side = all.min(tile);
                assert!(all.is_multiple_of(multiple) && all >= n + 2 * border && border <= overlap);
                let mut from = border;
                for span in &spans {
                    let [a, b] = span.kept;
                    assert!(a == from && b > a && span.start.is_multiple_of(multiple), "{tiling:?} {n} {span:?}");
                    assert!(span.start == 0 || a >= span.start + overlap, "{tiling:?} {n} {span:?}");
                    let end = span.start + side;
                    assert!(end == all || b + overlap <= end, "{tiling:?} {n} {span:?}");
                    from = b;
                }
                assert_eq!(from, border + n, "{tiling:?} {n}");
                let fewest = if all <= tile { 1 } else { (all - 2 * overlap).div_ceil(tiling.core) };
                assert!(spans.len() <= fewest, "{tiling:?} {n}: {} tiles", spans.len());
            }
        }
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
            assert!(run(image.clone(), all(&image), &bare(), tiling, parallel, &fails, &|_, _| ()).is_err());
            let shrinks = |_: ArrayView4<'_, f32>| Ok(Array4::zeros((1, 3, 8, 8)));
            assert!(run(image.clone(), all(&image), &bare(), tiling, parallel, &shrinks, &|_, _| ()).is_err());
            let breaks = |tile: ArrayView4<'_, f32>| Ok(tile.mapv(|v| if v > 0.9 { f32::NAN } else { v }));
            let error =
                run(image.clone(), all(&image), &bare(), tiling, parallel, &breaks, &|_, _| ()).expect_err("NaN");
            assert!(error.to_string().contains("NaN in the tile at row"), "{error}");
        }
    }
}
