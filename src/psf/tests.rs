//! PSFs known in closed form, and PSFs of beams that hardly exist.

use glam::DVec2;
use ndarray::{Array2, Array4, Axis};

use super::grid::{GridBar, PsfGrid, PsfNode, PsfPlan};
use super::pupil::PupilSampling;
use crate::lens::{Lens, builtin, prescription};
use crate::testing::{assert_abs, assert_rel};
use crate::trace::Failure;

/// A plano-hyperbolic singlet, focal length 50 mm: the conic −n² images the axis at infinity without any aberration.
/// The sensor stands `defocus` mm behind the focus; the stop is the pupil, of radius `stop`.
fn perfect(stop: f64, defocus: f64) -> Lens {
    let text = format!(
        r#"
schema = 1
name = "plano-hyperbolic singlet"
source = "conic -n^2 behind a plane: stigmatic for the axis at infinity (Descartes)"
aperture = {{ stop_semi_diameter_mm = {stop} }}
object = {{ distance_mm = inf }}
field = {{ max_angle_deg = 1.0 }}
wavelengths = {{ nm = [550.0], weights = [1.0], primary_nm = 550.0 }}
sensor = {{ columns = 100, rows = 100, pitch_um = 5.0 }}
[[surface]]
radius_mm = inf
thickness_mm = 2.0
medium = "air"
semi_diameter_mm = {stop}
stop = true
[[surface]]
radius_mm = inf
thickness_mm = 6.0
medium = {{ wavelength_nm = [400.0, 700.0], index = [1.5, 1.5] }}
semi_diameter_mm = 12.0
[[surface]]
radius_mm = -25.0
conic = -2.25
thickness_mm = {}
medium = "air"
semi_diameter_mm = 12.0
"#,
        50.0 + defocus
    );
    prescription::from_toml(&text, "perfect").expect("valid")
}

fn plan_of(sampling: PupilSampling, size: usize, pitch_mm: f64) -> PsfPlan {
    PsfPlan { sampling, size, pitch_mm, wavelength_nm: vec![550.0], weight: vec![vec![1.0]] }
}

/// Kernel and share outside of the axis, landings counted from `from_mm` along `outward`.
fn axis(lens: &Lens, plan: &PsfPlan, outward: [f64; 2], from_mm: f64) -> (Vec<f64>, f64) {
    let node = [PsfNode { radius: 0, outward }];
    let grid = PsfGrid::compute(lens, 0.0, plan, &[0.0], &[from_mm], &node).expect("traces");
    assert_abs(grid.kernels.sum() + grid.outside.sum(), 1.0, 1e-12, "energy");
    (grid.kernels.iter().copied().collect(), grid.outside[[0, 0]])
}

/// Box on tent, written from its definition.
fn box_on_tent(u: f64) -> f64 {
    let u = u.abs();
    if u < 0.5 {
        0.75 - u * u
    } else if u < 1.5 {
        0.5 * (1.5 - u) * (1.5 - u)
    } else {
        0.0
    }
}

/// In focus nothing is left but box and tent; focused on a pixel corner, four pixels get a quarter each.
#[test]
fn a_perfect_lens_in_focus_gives_box_on_tent() {
    let lens = perfect(10.0, 0.0);
    let pitch = 0.005;
    let plan = plan_of(PupilSampling::new(7, 300), 9, pitch);
    let (kernel, outside) = axis(&lens, &plan, [1.0, 0.0], 0.0);
    assert_eq!(outside, 0.0);
    for (i, v) in kernel.iter().enumerate() {
        let (row, column) = ((i / 9) as f64 - 4.0, (i % 9) as f64 - 4.0);
        assert_abs(*v, box_on_tent(row) * box_on_tent(column), 1e-9, "in focus, f/2.5");
    }
    let diagonal = [0.5f64.sqrt(); 2];
    let corner = |off: f64| axis(&lens, &plan, diagonal, (off - 0.5) * 2f64.sqrt() * pitch).0;
    for (i, v) in corner(0.0).iter().enumerate() {
        let inside = [4, 5].contains(&(i / 9)) && [4, 5].contains(&(i % 9));
        // β²(1/2) = 1/2 in each direction.
        assert_abs(*v, if inside { 0.25 } else { 0.0 }, 1e-9, "on a pixel corner");
    }
    // The corner is no kink: slopes from both sides agree.
    let (left, middle, right) = (corner(-1e-6), corner(0.0), corner(1e-6));
    for ((l, m), r) in left.iter().zip(&middle).zip(&right) {
        assert_abs((r - m) - (m - l), 0.0, 1e-11, "one slope on both sides");
    }
}

/// Out of focus: the uniform disc, on box and tent. Its integral is taken by brute force over 640 000 points.
#[test]
fn a_perfect_lens_out_of_focus_gives_the_defocus_disc() {
    let (stop, defocus, pitch, size) = (0.5, 5.0, 0.005, 31);
    // The marginal ray runs to the focus at 50 mm from the vertex; f/50, so slopes grow with height to 1e-4.
    let disc = stop / 50.0 * defocus / pitch;
    assert_abs(disc, 10.0, 1e-12, "pixels");
    let half = (size / 2) as f64;
    let mut exact = vec![0.0; size * size];
    let n = 800;
    for i in 0..n {
        let r = disc * ((f64::from(i) + 0.5) / f64::from(n)).sqrt();
        for j in 0..n {
            let p = r * DVec2::from_angle(std::f64::consts::TAU * (f64::from(j) + 0.5) / f64::from(n));
            for row in 0..size {
                let y = box_on_tent(row as f64 - half - p.y);
                if y == 0.0 {
                    continue;
                }
                for column in 0..size {
                    exact[row * size + column] += y * box_on_tent(column as f64 - half - p.x) / f64::from(n * n);
                }
            }
        }
    }
    assert_abs(exact.iter().sum(), 1.0, 1e-12, "the disc lies inside");
    let lens = perfect(stop, defocus);
    // What the number of dense points leaves, by count.
    for (dense, limit) in [(300, 0.04), (1000, 0.012), (4000, 3e-3), (20_000, 8e-4)] {
        let plan = plan_of(PupilSampling::new(3, dense), size, pitch);
        let (kernel, outside) = axis(&lens, &plan, [1.0, 0.0], 0.0);
        assert_eq!(outside, 0.0);
        let off: f64 = kernel.iter().zip(&exact).map(|(a, b)| (a - b) * (a - b)).sum();
        let error = (off / exact.iter().map(|b| b * b).sum::<f64>()).sqrt();
        eprintln!("defocus disc of 10 pixels, {dense} points: {error:.1e}");
        assert!(error < limit, "{dense}: {error:e}");
        // In the middle of the disc the kernel is 1/(π r²).
        let middle = (12..19).flat_map(|r| (12..19).map(move |c| r * size + c)).map(|i| kernel[i]).sum::<f64>() / 49.0;
        assert_rel(middle, 1.0 / (std::f64::consts::PI * disc * disc), limit, 0.0, "middle");
    }
}

fn pull(lens: &Lens, v: f64, plan: &PsfPlan, slopes: &[f64], radii: &[f64]) -> Result<(PsfGrid, GridBar), Failure> {
    let nodes: Vec<PsfNode> = (0..slopes.len()).map(|radius| PsfNode { radius, outward: [0.6, 0.8] }).collect();
    let grid = PsfGrid::compute(lens, v, plan, slopes, radii, &nodes)?;
    let k_bar = Array4::from_elem(grid.kernels.dim(), 1.0);
    let t_bar = Array2::from_elem(grid.throughput.dim(), 0.0);
    let bar = grid.vjp(lens, v, plan, slopes, radii, &nodes, &k_bar, &t_bar);
    Ok((grid, bar))
}

fn finite(lens: &Lens, grid: &PsfGrid, bar: &GridBar) -> bool {
    let variables = crate::lens::variables::Variables::all(lens);
    let gradient = variables.gradient(&bar.lens);
    let values = grid.kernels.iter().chain(&grid.throughput).chain(&grid.outside);
    values.chain(&gradient).chain(&bar.slopes).chain(&bar.radii_mm).all(|v| v.is_finite())
}

/// All energy beside the window: the kernel is 0, all of it counts as outside, and nothing pulls.
#[test]
fn energy_outside_the_window_is_reported() {
    let lens = builtin::lens("cooke_triplet").expect("shipped");
    let plan = plan_of(PupilSampling::new(5, 100), 15, 0.006);
    let (grid, bar) = pull(&lens, 0.0, &plan, &[0.1], &[3.0]).expect("traces");
    assert!(grid.kernels.iter().all(|v| *v == 0.0));
    assert_abs(grid.outside[[0, 0]], 1.0, 1e-12, "outside");
    assert!(grid.throughput[[0, 0]] > 0.0 && finite(&lens, &grid, &bar));
    assert_eq!((bar.slopes[0], bar.radii_mm[0]), (0.0, 0.0));
}

/// A stop that is nearly closed is one ray: box and tent about it.
#[test]
fn a_nearly_closed_stop_is_one_ray() {
    for stop in [1e-4, 1e-8] {
        let lens = perfect(stop, 3.0);
        let plan = plan_of(PupilSampling::new(5, 100), 9, 0.005);
        let (kernel, _) = axis(&lens, &plan, [1.0, 0.0], 0.0);
        for (i, v) in kernel.iter().enumerate() {
            let (row, column) = ((i / 9) as f64 - 4.0, (i % 9) as f64 - 4.0);
            assert_abs(*v, box_on_tent(row) * box_on_tent(column), 1e-5, "one ray");
        }
        let (grid, bar) = pull(&lens, 0.0, &plan, &[0.0], &[0.0]).expect("traces");
        assert_rel(grid.throughput[[0, 0]], std::f64::consts::PI * stop * stop, 1e-6, 0.0, "étendue");
        assert!(finite(&lens, &grid, &bar));
    }
}

/// An aperture closes over the beam until no dense ray is left: kernels of one ray, then of none, and no NaN.
#[test]
fn a_vignetted_beam_ends_in_a_kernel_of_zeros() {
    let shipped = builtin::lens("two_element").expect("shipped");
    let v = shipped.object_vergence;
    let plan = plan_of(PupilSampling::new(5, 100), 129, 0.006);
    // A beam that leaves the first surface's vertex aside.
    let slope = 0.55;
    let radius = super::chief::chief_heights(&shipped, v, &[slope]).expect("aims")[0];
    let (mut few, mut none) = (0, 0);
    for step in 0..120 {
        let mut lens = shipped.clone();
        lens.surfaces[0].semi_diameter = 12.0 * 0.95f64.powi(step);
        let (grid, bar) = pull(&lens, v, &plan, &[0.0, slope], &[0.0, radius]).expect("unclipped rays all arrive");
        assert!(finite(&lens, &grid, &bar), "step {step}");
        let sum = grid.kernels.index_axis(Axis(0), 1).sum() + grid.outside[[1, 0]];
        let t = grid.throughput[[1, 0]];
        if t == 0.0 {
            none += 1;
            assert_eq!(sum, 0.0);
        } else {
            assert_abs(sum, 1.0, 1e-12, "energy");
            few += i32::from(t < 1e-2 * std::f64::consts::PI * 6.25 * 6.25);
        }
    }
    assert!(few > 0 && none > 0, "{few} {none}");
}

/// An object at the lens, inside it, and nowhere: a failure, or numbers.
#[test]
fn an_object_at_the_lens_gives_numbers_or_a_failure() {
    let strange = [0.1, 1.0, 1e3, 1e9, 1e150, 1e300, -0.05, -1.0, -1e9, f64::INFINITY, f64::NEG_INFINITY, f64::NAN];
    let (mut traced, mut failed) = (0, 0);
    for name in ["two_element", "cooke_triplet", "phone"] {
        let lens = builtin::lens(name).expect("shipped");
        let pupil = crate::trace::aim::ParaxialPupil::new(&lens);
        // The vergence of an object at the entrance pupil as well: no magnification there.
        for v in strange.into_iter().chain([-1.0 / pupil.z]) {
            for slopes in [[0.0, 0.2], [1e9, f64::NAN], [1e300, -f64::INFINITY]] {
                let plan = plan_of(PupilSampling::new(5, 60), 15, 0.006);
                match pull(&lens, v, &plan, &slopes, &[0.0, 3.0]) {
                    Ok((grid, bar)) => {
                        traced += 1;
                        assert!(finite(&lens, &grid, &bar), "{name}: vergence {v:e}, slopes {slopes:?}");
                    }
                    Err(f) => {
                        failed += 1;
                        assert!(f.surface <= lens.surfaces.len(), "{f:?}");
                    }
                }
            }
        }
    }
    eprintln!("{traced} traced, {failed} failed");
    assert!(failed > 0);
}
