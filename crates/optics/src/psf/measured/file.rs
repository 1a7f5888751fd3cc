//! Measured point spread functions as a file: NumPy's `.npz` with `schema`, `size` (columns, rows), `centre_px`, `reach_px`, `spacing_px`, `radii_px`, `moves`
//! `[move, 2]` (along and across the meridian, in spacings) and `weights` `[radius, channel, move]`.

use std::io::Cursor;
use std::path::Path;

use ndarray::{Array1, Array2, Array3, Ix1, Ix2, Ix3, arr0};
use ndarray_npy::{NpzReader, NpzWriter, ReadableElement};

use super::{MeasuredPsf, Moves};
use isoplanat_base::atomic;
use isoplanat_base::error::{Error, Result};
use isoplanat_base::math::npz;

/// Bytes of a file at most.
const MOST: u64 = 1 << 28;
/// The newest form that is read, and the one that is written: knots over the radius. Files of before numbers were given have none.
const SCHEMA: i64 = 1;
const ALLOWED: &str = "point spread functions, as `isoplanat calibrate --psf` writes them";

impl MeasuredPsf {
    /// The bytes of the file.
    ///
    /// # Errors
    /// None that is the user's.
    #[expect(clippy::cast_possible_wrap, reason = "raster sizes")]
    pub fn to_npz(&self) -> Result<Vec<u8>> {
        let failed = |e: ndarray_npy::WriteNpzError| Error::Internal(format!("PSFs to npz: {e}"));
        let (knots, channels, count) = (self.radii_px.len(), self.channels(), self.moves.len());
        let weights = Array3::from_shape_fn((knots, channels, count), |(j, c, m)| self.weights[j][c][m]);
        let moves = Array2::from_shape_fn((count, 2), |(m, k)| self.moves.steps[m][k]);
        let mut npz = NpzWriter::new(Cursor::new(Vec::new()));
        npz.add_array("schema", &arr0(SCHEMA)).map_err(failed)?;
        npz.add_array("size", &Array1::from(self.size.map(|n| n as i64).to_vec())).map_err(failed)?;
        npz.add_array("centre_px", &Array1::from(self.centre_px.to_vec())).map_err(failed)?;
        npz.add_array("reach_px", &Array1::from(vec![self.moves.reach_px])).map_err(failed)?;
        npz.add_array("spacing_px", &Array1::from(vec![self.moves.spacing_px])).map_err(failed)?;
        npz.add_array("radii_px", &Array1::from(self.radii_px.clone())).map_err(failed)?;
        npz.add_array("moves", &moves).map_err(failed)?;
        npz.add_array("weights", &weights).map_err(failed)?;
        Ok(npz.finish().map_err(failed)?.into_inner())
    }

    /// Reads and checks a file.
    ///
    /// # Errors
    /// A file that cannot be read, or holds something else.
    pub fn load(path: &Path) -> Result<Self> {
        Self::from_npz(&atomic::read_bounded(path, MOST)?, path)
    }

    /// From the bytes of a file, which `path` names.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn from_npz(bytes: &[u8], path: &Path) -> Result<Self> {
        let bad = |place: &str, e: String| Error::bad(path.display().to_string(), place, e, ALLOWED);
        npz::check(bytes).map_err(|(place, found)| bad(&place, found))?;
        let mut npz = NpzReader::new(Cursor::new(bytes)).map_err(|e| bad("file", e.to_string()))?;
        npz::require_schema(&mut npz, SCHEMA, path)?;
        let mut one = Read { npz: &mut npz, path };
        let size: Vec<i64> = one.line("size")?;
        let size = <[i64; 2]>::try_from(size).ok().and_then(|s| Some([s[0].try_into().ok()?, s[1].try_into().ok()?]));
        let size: [usize; 2] = size.ok_or_else(|| bad("size", "not two counts".into()))?;
        let centre: Vec<f64> = one.line("centre_px")?;
        let centre_px = <[f64; 2]>::try_from(centre).map_err(|v| bad("centre_px", format!("{} numbers", v.len())))?;
        let [reach, spacing] = ["reach_px", "spacing_px"].map(|name| one.line::<f64>(name));
        let (reach, spacing) = (reach?, spacing?);
        let (&[reach], &[spacing]) = (&reach[..], &spacing[..]) else {
            return Err(bad("reach_px, spacing_px", "not one number each".into()));
        };
        let moves = Moves::within(reach, spacing).map_err(|e| e.in_file(path))?;
        let steps: Array2<i32> = one.array::<i32, Ix2>("moves")?;
        let same =
            steps.dim() == (moves.len(), 2) && steps.outer_iter().zip(&moves.steps).all(|(a, b)| a.iter().eq(b.iter()));
        if !same {
            return Err(bad("moves", format!("{:?} steps, not those within the reach", steps.dim())));
        }
        let radii_px: Vec<f64> = one.line("radii_px")?;
        let weights: Array3<f64> = one.array::<f64, Ix3>("weights")?;
        let weights = weights.outer_iter().map(|r| r.outer_iter().map(|w| w.to_vec()).collect()).collect();
        Self::new(size, centre_px, moves, radii_px, weights).map_err(|e| e.in_file(path))
    }
}

/// Arrays of a file by name.
struct Read<'a, 'b> {
    npz: &'a mut NpzReader<Cursor<&'b [u8]>>,
    path: &'a Path,
}

impl Read<'_, '_> {
    fn array<T: ReadableElement, D: ndarray::Dimension>(&mut self, name: &str) -> Result<ndarray::Array<T, D>> {
        let path = self.path.display().to_string();
        self.npz.by_name(name).map_err(|e| Error::bad(path, name, e.to_string(), ALLOWED))
    }

    fn line<T: ReadableElement + Clone>(&mut self, name: &str) -> Result<Vec<T>> {
        Ok(self.array::<T, Ix1>(name)?.to_vec())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_come_back_and_others_are_refused() {
        let moves = Moves::within(2.0, 0.5).expect("valid");
        let rng = &mut fastrand::Rng::with_seed(7);
        let mut kernel = || {
            let mut w: Vec<f64> = (0..moves.len()).map(|_| rng.f64()).collect();
            let sum: f64 = moves.iter().zip(&w).map(|((_, n), w)| n * w).sum();
            w.iter_mut().for_each(|w| *w /= sum);
            w
        };
        let weights = (0..3).map(|_| (0..3).map(|_| kernel()).collect()).collect();
        let psf = MeasuredPsf::new([640, 480], [321.5, 239.0], moves.clone(), vec![0.0, 10.0, 300.0], weights)
            .expect("valid");
        let bytes = psf.to_npz().expect("writes");
        let path = Path::new("psf.npz");
        assert_eq!(MeasuredPsf::from_npz(&bytes, path).expect("reads"), psf);
        for cut in [0, 10, bytes.len() / 2, bytes.len() - 1] {
            let error = MeasuredPsf::from_npz(&bytes[..cut], path).expect_err("cut");
            assert!(error.exit_code() == 2 && error.to_string().contains("psf.npz"), "{error}");
        }
        let of_schema = |schema: i64| {
            let mut npz = NpzWriter::new(Cursor::new(Vec::new()));
            npz.add_array("schema", &arr0(schema)).expect("writes");
            let bytes = npz.finish().expect("writes").into_inner();
            MeasuredPsf::from_npz(&bytes, path).expect_err("no file").to_string()
        };
        assert!(of_schema(2).contains("psf.npz: schema: 2"), "{}", of_schema(2));
        assert!(of_schema(0).contains("schema 1 to 1") && of_schema(1).contains("size"), "{}", of_schema(0));
        for _ in 0..300 {
            let mut changed = bytes.clone();
            (0..1 + rng.usize(0..8)).for_each(|_| changed[rng.usize(0..bytes.len())] = rng.u8(..));
            // An answer or an error, no panic; what is read is valid.
            if let Ok(read) = MeasuredPsf::from_npz(&changed, path) {
                assert_eq!(read.moves.len(), read.weights(0, 0).len());
            }
        }
    }
}
