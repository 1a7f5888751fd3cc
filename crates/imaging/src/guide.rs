//! What a network is told beside the capture: the capture through the lens's own Wiener filters, the place in the field, and what the point spread function there
//! is like.
//!
//! A [`Guide`] belongs to a trained network as its weights do: it is made when a training begins, stands in the run's folder and in the
//! kit, and training, evaluation and camera stack its channels by the one function [`Guide::over`].

mod adjoint;
mod facts;
mod filters;
mod spread;
#[cfg(test)]
mod tests;

use ndarray::{Array3, ArrayView3, s};

pub use adjoint::Record;
pub use facts::{FILE, Facts, LARGEST};
pub use filters::Filters;
pub use isoplanat_card::Inputs;
pub use spread::Spread;

use crate::develop::simulate::Electronics;
use crate::frame::Frame;
use crate::plane::{Region, turned};
use crate::render::Renderer;
use isoplanat_base::error::{Error, Result};

/// The channels that a network of one lens on one frame sees.
#[derive(Clone, Debug, PartialEq)]
pub struct Guide {
    inputs: Inputs,
    frame: Frame,
    facts: Facts,
}

impl Guide {
    /// The capture alone.
    pub fn bare(frame: &Frame) -> Self {
        Self { inputs: Inputs::BARE, frame: frame.clone(), facts: Facts::default() }
    }

    /// What `inputs` name, for the lens that `renderer` holds and the noise of `electronics`.
    ///
    /// # Errors
    /// As [`Filters::compute`].
    pub fn new(inputs: Inputs, renderer: &Renderer, electronics: &Electronics) -> Result<Self> {
        Self::from_parts(inputs, &renderer.plan.frame, Facts::of(inputs, renderer, electronics)?)
    }

    /// From its parts.
    ///
    /// # Errors
    /// Facts where none are named or the other way round; filters of another frame.
    pub fn from_parts(inputs: Inputs, frame: &Frame, facts: Facts) -> Result<Self> {
        for (what, needed, there) in [
            ("Wiener filters", inputs.wiener, facts.filters.is_some()),
            ("Wiener filters of other noise", inputs.levels, facts.levels.is_some()),
            ("point spread functions", inputs.psf, facts.spread.is_some()),
        ] {
            if needed != there {
                let found = if needed { "none" } else { "some" };
                return Err(Error::bad("", what, found, format!("what inputs {:?} need", inputs.names())));
            }
        }
        for filters in facts.banks() {
            filters::check(filters, frame)?;
        }
        if let Some(spread) = &facts.spread {
            spread.check(frame)?;
        }
        Ok(Self { inputs, frame: frame.clone(), facts })
    }

    /// The frame it belongs to.
    pub fn frame(&self) -> &Frame {
        &self.frame
    }

    /// What it shows.
    pub fn inputs(&self) -> Inputs {
        self.inputs
    }

    /// What it holds of its lens, where that is anything.
    pub fn facts(&self) -> Option<&Facts> {
        Some(&self.facts).filter(|f| !f.is_empty())
    }

    /// Pixels beyond a region that its channels depend on.
    pub fn reach(&self) -> usize {
        self.facts.banks().map(Filters::reach).max().unwrap_or(0)
    }

    /// The network's input over `wanted`, `[channel, row, col]`. The capture `image` `[3, row, col]` lies at `at` of the frame and
    /// covers `wanted`; it should reach [`Self::reach`] pixels further, or to the frame's edge, beyond which it is mirrored.
    pub fn over(&self, image: ArrayView3<'_, f32>, at: Region, wanted: Region) -> Array3<f32> {
        self.stacked(image, at, wanted, self.facts.banks().map(|f| f.over(image, at, wanted)))
    }

    /// Row and column of `wanted`'s first pixel in `at`.
    fn offset(at: Region, wanted: Region) -> (usize, usize) {
        ((wanted.row - at.row).unsigned_abs(), (wanted.col - at.col).unsigned_abs())
    }

    fn stacked(
        &self,
        image: ArrayView3<'_, f32>,
        at: Region,
        wanted: Region,
        filtered: impl Iterator<Item = Array3<f32>>,
    ) -> Array3<f32> {
        let (row, col) = Self::offset(at, wanted);
        let mut out = Array3::zeros((self.inputs.channels(), wanted.rows, wanted.cols));
        out.slice_mut(s![..3, .., ..]).assign(&image.slice(s![.., row..row + wanted.rows, col..col + wanted.cols]));
        let mut next = 3;
        for filtered in filtered {
            out.slice_mut(s![next..next + 3, .., ..]).assign(&filtered);
            next += 3;
        }
        if self.inputs.field {
            let largest = self.frame.max_radius_mm() / self.frame.pitch_mm;
            for i in 0..wanted.rows {
                for j in 0..wanted.cols {
                    let [x, y] = wanted.offset(&self.frame, i, j).map(|v| v / largest);
                    #[expect(clippy::cast_possible_truncation, reason = "numbers up to 1")]
                    for (k, v) in [x, y, x * x + y * y].into_iter().enumerate() {
                        out[[next + k, i, j]] = v as f32;
                    }
                }
            }
            next += 3;
        }
        if let Some(spread) = &self.facts.spread {
            spread.write(&self.frame, wanted, out.slice_mut(s![next.., .., ..]));
        }
        out
    }

    /// Mirrors and transposes channels of [`Self::over`] as a training does (rows, columns, then both swapped): what a network would
    /// see at the mirrored place of a rotationally symmetric lens.
    pub fn turned(&self, channels: &mut Array3<f32>, turns: [bool; 3]) {
        let swap = turns[2] && channels.dim().1 == channels.dim().2;
        let mut turned = turned(channels.view(), turns);
        if self.inputs.field {
            let first = turned.dim().0 - 3 - if self.inputs.psf { isoplanat_card::SPREAD } else { 0 };
            if turns[0] {
                turned.slice_mut(s![first + 1, .., ..]).mapv_inplace(|v| -v);
            }
            if turns[1] {
                turned.slice_mut(s![first, .., ..]).mapv_inplace(|v| -v);
            }
            if swap {
                let x = turned.slice(s![first, .., ..]).to_owned();
                let y = turned.slice(s![first + 1, .., ..]).to_owned();
                turned.slice_mut(s![first, .., ..]).assign(&y);
                turned.slice_mut(s![first + 1, .., ..]).assign(&x);
            }
        }
        if self.inputs.psf {
            let first = turned.dim().0 - isoplanat_card::SPREAD;
            Spread::turn(turned.slice_mut(s![first.., .., ..]), [turns[0], turns[1], swap]);
        }
        *channels = turned;
    }
}
