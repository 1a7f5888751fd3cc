//! Lens files of every form. A lens that is read is written as TOML and read again with the same text, and in the forms of other programs, where it can
//! be written in one, it is read again.

use isoplanat::interchange::{Form, load, parse, text_of};
use isoplanat::lens::builtin;
use isoplanat::lens::catalogue::Glasses;

use super::{again, file, read};

pub(super) fn zmx(bytes: &[u8]) {
    lens("a.zmx", bytes);
}

pub(super) fn seq(bytes: &[u8]) {
    lens("a.seq", bytes);
}

pub(super) fn json(bytes: &[u8]) {
    lens("a.json", bytes);
}

pub(super) fn txt(bytes: &[u8]) {
    lens("a.txt", bytes);
}

pub(super) fn prescription(bytes: &[u8]) {
    lens("a.toml", bytes);
}

fn lens(name: &str, bytes: &[u8]) {
    let glasses = Glasses::shipped();
    let Some(imported) = read(name, load(&file(name, bytes), glasses)) else { return };
    assert!(imported.notes.iter().all(|note| !note.contains('\n')), "{:?}", imported.notes);
    let own = |lens| again(text_of(lens, Form::Toml, glasses), "").0;
    let text = own(&imported.lens);
    let second = again(parse(&text, Form::Toml, "again.toml", glasses), &text);
    assert_eq!(own(&second.lens), text, "another lens");
    for form in [Form::Zmx, Form::Seq] {
        if let Some((text, _)) = read(name, text_of(&imported.lens, form, glasses)) {
            let there = again(parse(&text, form, "again", glasses), &text).lens;
            assert_eq!(there.surfaces.len(), imported.lens.surfaces.len(), "{text}");
        }
    }
}

/// The shipped lenses, as far as a form can say them.
fn shipped(form: Form) -> Vec<Vec<u8>> {
    let lenses = builtin::LENSES.iter().map(|(name, _)| builtin::lens(name).expect("shipped"));
    lenses.filter_map(|lens| Some(text_of(&lens, form, Glasses::shipped()).ok()?.0.into_bytes())).collect()
}

pub(super) fn zmx_starts() -> Vec<Vec<u8>> {
    shipped(Form::Zmx)
}

pub(super) fn seq_starts() -> Vec<Vec<u8>> {
    shipped(Form::Seq)
}

/// The same singlet in the forms of Optiland and of DeepLens.
pub(super) fn json_starts() -> Vec<Vec<u8>> {
    let surface = |z: &str, radius: &str, index: &str, stop: bool| {
        format!(
            "{{\"type\":\"Surface\",\"is_stop\":{stop},\"aperture\":null,\"interaction_model\":{{\"type\":\"RefractiveReflectiveModel\"}},\
             \"geometry\":{{\"type\":\"EvenAsphere\",\"radius\":{radius},\"conic\":-1.0,\"coefficients\":[0.0,1e-6],\
             \"cs\":{{\"x\":0.0,\"y\":0.0,\"z\":{z},\"rx\":0.0,\"ry\":0.0,\"rz\":0.0}}}},\
             \"material_post\":{{\"type\":\"IdealMaterial\",\"index\":{index}}}}}"
        )
    };
    let surfaces = [
        surface("-200.0", "Infinity", "1.0", false),
        surface("0.0", "40.0", "1.5168", true),
        surface("3.0", "-60.0", "1.0", false),
        surface("70.0", "Infinity", "1.0", false),
    ];
    let optiland = format!(
        "{{\"version\":1.0,\"name\":null,\"aperture\":{{\"type\":\"EPD\",\"value\":8.0}},\
         \"fields\":{{\"field_type\":\"angle\",\"fields\":[{{\"x\":0.0,\"y\":0.0}},{{\"x\":0.0,\"y\":6.0,\"vx\":0.0,\"vy\":0.1}}]}},\
         \"wavelengths\":{{\"wavelengths\":[{{\"value\":0.5876,\"is_primary\":true,\"unit\":\"um\"}}]}},\
         \"surface_group\":{{\"surfaces\":[{}]}}}}",
        surfaces.join(",")
    );
    let deeplens = "{\"info\":\"a\",\"foclen\":47.0,\"fnum\":5.0,\"r_sensor\":8.0,\"(sensor_size)\":[12.0,9.0],\"d_sensor\":60.0,\"surfaces\":[\
                    {\"type\":\"Aspheric\",\"r\":6.0,\"(c)\":0.025,\"roc\":40.0,\"k\":0.1,\"ai\":[0.0,1e-6],\"d\":0.0,\"d_next\":3.0,\"mat2\":\"1.5168/64.2\"},\
                    {\"type\":\"Spheric\",\"r\":6.0,\"roc\":-60.0,\"d\":3.0,\"d_next\":1.0,\"mat2\":\"air\"},\
                    {\"type\":\"Aperture\",\"r\":4.0,\"d\":4.0,\"d_next\":56.0}]}";
    vec![optiland.into_bytes(), deeplens.as_bytes().to_vec()]
}

pub(super) fn txt_starts() -> Vec<Vec<u8>> {
    let text = "a\ntype distance roc diameter material\nO 0 0 0 AIR\nS 1 40 12 N-BK7 0.1 0 1e-6\nS 3 -60 12 1.62/36.4\nA 1 0 8 occluder\nI 56 0 16 AIR\n";
    vec![text.as_bytes().to_vec()]
}

pub(super) fn prescription_starts() -> Vec<Vec<u8>> {
    shipped(Form::Toml)
}
