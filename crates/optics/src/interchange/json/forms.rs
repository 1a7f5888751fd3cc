//! Forms of files that programs write today, beside those that they wrote before.

use serde_json::{Value, json};

use crate::interchange::{Form, Imported, parse};
use crate::lens::catalogue::Glasses;
use crate::lens::{ImageSurface, paraxial};
use isoplanat_base::error::Result;
use isoplanat_base::testing::assert_rel;

fn read(value: &Value) -> Result<Imported> {
    parse(&value.to_string(), Form::Json, "a.json", Glasses::shipped())
}

/// A singlet of radii 40 and −60 mm as Optiland writes it, with its fields and aperture, and what its surfaces do.
fn optiland(fields: &Value, aperture: &Value, does: &Value) -> Value {
    let surface = |z: f64, radius: Value, index: f64, stop: bool| {
        let plane = radius.is_string();
        json!({ "type": "Surface", "is_stop": stop, "aperture": null, "interaction_model": does,
            "geometry": { "type": if plane { "Plane" } else { "StandardGeometry" }, "radius": radius, "conic": 0.0,
                "cs": { "x": 0.0, "y": 0.0, "z": z, "rx": 0.0, "ry": 0.0, "rz": 0.0 } },
            "material_post": { "type": "IdealMaterial", "index": index } })
    };
    json!({ "version": 1.0, "name": null, "aperture": aperture, "fields": fields,
        "wavelengths": { "wavelengths": [{ "value": 0.5876, "is_primary": true, "unit": "um" }] },
        "surface_group": { "surfaces": [
            surface(-200.0, json!("Infinity"), 1.0, false),
            surface(0.0, json!(40.0), 1.5168, true),
            surface(3.0, json!(-60.0), 1.0, false),
            surface(70.0, json!("Infinity"), 1.0, false),
        ] } })
}

fn points(kind: &Value) -> Value {
    let mut fields = json!({ "fields": [{ "x": 0.0, "y": 0.0 }, { "x": 0.0, "y": 6.0 }] });
    fields.as_object_mut().expect("an object").extend(kind.as_object().expect("an object").clone());
    fields
}

/// Version 0.6 names the type of its fields by a class in a part of its own: the lens is that of the older form.
#[test]
fn field_types_of_optiland_are_read_in_both_forms() {
    let (stop, glass) = (json!({ "type": "EPD", "value": 8.0 }), json!({ "type": "RefractiveReflectiveModel" }));
    let largest = |kind: &Value| read(&optiland(&points(kind), &stop, &glass)).expect("reads").lens.max_field_deg();
    let mut found = Vec::new();
    for (old, new) in [
        ("angle", "AngleField"),
        ("object_height", "ObjectHeightField"),
        ("paraxial_image_height", "ParaxialImageHeightField"),
        ("real_image_height", "RealImageHeightField"),
    ] {
        let [a, b] =
            [json!({ "field_type": old }), json!({ "field_definition": { "field_type": new } })].map(|k| largest(&k));
        assert_eq!(a, b, "{new}");
        found.push(a);
    }
    assert_rel(found[0], 6.0, 1e-12, 0.0, "6 degrees");
    // The stop is the first surface, 200 mm from the object.
    assert_rel(found[1], (6f64 / 200.0).atan().to_degrees(), 1e-9, 0.0, "6 mm at the object");
    // Heights on the paraxial image, and on the sensor a tenth behind it.
    assert!((1.0..1.2).contains(&(found[2] / found[3])) && found[2] > 3.0 && found[2] < 7.0, "{found:?}");
    let other = json!({ "field_definition": { "field_type": "PupilField" } });
    let error = read(&optiland(&points(&other), &stop, &glass)).expect_err("unknown").to_string();
    assert!(error.contains("PupilField"), "{error}");
}

#[test]
fn what_surfaces_of_optiland_do_is_read_in_both_forms() {
    let (fields, stop) = (points(&json!({ "field_type": "angle" })), json!({ "type": "EPD", "value": 8.0 }));
    for (does, said) in [
        (json!({ "type": "RefractiveReflectiveModel", "is_reflective": true }), "mirror"),
        (json!({ "type": "ThinLensInteractionModel", "is_reflective": false }), "no focal length"),
        // Curved, and in glass.
        (json!({ "type": "ThinLensInteractionModel", "focal_length": 50.0 }), "an ideal lens is a plane"),
        (json!({ "type": "DiffractiveModel" }), "Diffractive"),
        (json!({ "type": "RefractiveReflectiveModel", "bsdf": { "type": "Lambertian" } }), "scattering"),
    ] {
        let error = read(&optiland(&fields, &stop, &does)).expect_err(said).to_string();
        assert!(error.contains(said), "{error}");
    }
    // The stop's own diameter.
    let (stop, glass) =
        (json!({ "type": "float_by_stop_size", "value": 6.0 }), json!({ "type": "RefractiveReflectiveModel" }));
    let lens = read(&optiland(&fields, &stop, &glass)).expect("reads").lens;
    assert_rel(paraxial::stop_semi_diameter(&lens), 3.0, 1e-12, 0.0, "stop");
}

/// Images of every kind of form: a conic is landed on, terms beyond it are told, what is none is refused; so is one that is shifted or turned.
#[test]
fn images_of_optiland_have_their_form() {
    let (fields, stop) = (points(&json!({ "field_type": "angle" })), json!({ "type": "EPD", "value": 8.0 }));
    let with = |kind: &str, more: &Value| {
        let mut file = optiland(&fields, &stop, &json!({ "type": "RefractiveReflectiveModel" }));
        let geometry = file["surface_group"]["surfaces"][3]["geometry"].as_object_mut().expect("an object");
        geometry.insert("type".into(), json!(kind));
        for (key, value) in more.as_object().expect("an object") {
            match key.as_str() {
                "x" | "rx" => geometry["cs"][key] = value.clone(),
                _ => drop(geometry.insert(key.clone(), value.clone())),
            }
        }
        read(&file)
    };
    let curved = with("StandardGeometry", &json!({ "radius": -80.0, "conic": 0.5 })).expect("reads");
    assert_eq!(curved.lens.image, ImageSurface { curvature: -1.0 / 80.0, conic: 0.5 });
    assert!(curved.notes.iter().any(|n| n.contains("the image is curved")), "{:?}", curved.notes);
    assert!(with("Plane", &json!({ "radius": -80.0 })).expect("reads").lens.image.is_plane());
    for (terms, told) in [(json!([1e-4, 0.0]), true), (json!([0.0]), false)] {
        let read = with("EvenAsphere", &json!({ "radius": "Infinity", "coefficients": terms })).expect("reads");
        assert_eq!(read.notes.iter().any(|n| n.contains("terms of the image's form")), told, "{:?}", read.notes);
    }
    for (kind, more, said) in [
        ("BiconicGeometry", json!({ "radius_x": 30.0 }), "an image of type BiconicGeometry"),
        ("Plane", json!({ "x": 1.0 }), "x = 1"),
        ("Plane", json!({ "rx": 0.1 }), "rx = 0.1"),
    ] {
        let error = with(kind, &more).expect_err(said).to_string();
        assert!(error.contains(said), "{error}");
    }
}

/// A thin lens of either program: an object 200 mm before a lens of 50 mm has its image at 66 2/3 mm.
#[test]
fn thin_lenses_are_ideal() {
    let (fields, stop) = (points(&json!({ "field_type": "angle" })), json!({ "type": "EPD", "value": 8.0 }));
    let mut file = optiland(&fields, &stop, &json!({ "type": "RefractiveReflectiveModel" }));
    let surfaces = file["surface_group"]["surfaces"].as_array_mut().expect("surfaces");
    surfaces.remove(2);
    surfaces[1]["geometry"]["radius"] = json!("Infinity");
    surfaces[1]["geometry"]["type"] = json!("Plane");
    surfaces[1]["material_post"]["index"] = json!(1.0);
    surfaces[1]["interaction_model"] = json!({ "type": "ThinLensInteractionModel", "focal_length": 50.0 });
    let lens = read(&file).expect("reads").lens;
    let first = paraxial::first_order(&lens, 587.6);
    assert_rel(first.effective_focal_length, 50.0, 1e-15, 0.0, "focal length");
    assert_rel(first.paraxial_image_distance, 200.0 / 3.0, 1e-14, 0.0, "image");
    // DeepLens: before the singlet of the next test.
    let thin = json!({ "type": "ThinLens", "r": 4.0, "d": 4.0, "d_next": 56.0, "f": 50.0 });
    let alone = json!({ "info": "a", "foclen": 50.0, "fnum": 8.0, "r_sensor": 4.0, "d_sensor": 50.0, "surfaces": [
        { "type": "Aperture", "r": 3.125, "d": 0.0, "d_next": 0.0 }, thin ] });
    let first = paraxial::first_order(&read(&alone).expect("reads").lens, 587.6);
    assert_rel(first.effective_focal_length, 50.0, 1e-15, 0.0, "focal length");
}

/// DeepLens writes no medium behind an aperture: it stands in air. A diffractive surface beside the lens is no lens without it.
#[test]
fn apertures_and_diffractive_surfaces_of_deeplens() {
    let lens = |aperture: Value| {
        json!({ "info": "a", "foclen": 47.0, "fnum": 5.0, "r_sensor": 8.0, "d_sensor": 60.0, "surfaces": [
            { "type": "Spheric", "r": 6.0, "roc": 40.0, "d": 0.0, "d_next": 3.0, "mat2": "1.5168/64.2" },
            { "type": "Spheric", "r": 6.0, "roc": -60.0, "d": 3.0, "d_next": 1.0, "mat2": "air" },
            aperture,
        ] })
    };
    let stop = json!({ "type": "Aperture", "r": 4.0, "d": 4.0, "d_next": 56.0 });
    let with = json!({ "type": "Aperture", "r": 4.0, "d": 4.0, "d_next": 56.0, "mat2": "air" });
    let [a, b] = [stop.clone(), with].map(|s| read(&lens(s)).expect("reads").lens);
    let text = |l: &crate::lens::Lens| crate::lens::prescription::to_toml(l);
    assert_eq!(text(&a), text(&b));
    let mut hybrid = lens(stop);
    hybrid["DOE"] = json!({ "type": "Fresnel" });
    let error = read(&hybrid).expect_err("a diffractive surface").to_string();
    assert!(error.contains("DOE") && error.contains("diffractive"), "{error}");
    let phase = lens(json!({ "type": "Phase", "r": 4.0, "d": 4.0, "d_next": 56.0 }));
    assert!(read(&phase).expect_err("a phase").to_string().contains("Phase"));
}
