//! Optiland: surfaces by the places of their vertices, materials by name, constant index or index and Abbe number.

use serde_json::Value;

use super::Part;
use crate::interchange::draft::{Draft, FieldKind, Point, Size, Stage};
use crate::interchange::media::Stated;
use crate::interchange::text::shown;
use crate::lens::ImageSurface;
use crate::lens::check::MAX_SURFACES;
use isoplanat_base::error::{Location, Result};

pub(super) fn read(value: &Value, file: &str) -> Result<Draft> {
    let whole = Part::new(value, file);
    let mut draft = Draft::new("Optiland file");
    draft.title = whole.get("name").and_then(|n| n.value.as_str()).unwrap_or_default().chars().take(200).collect();
    let stop_mm = aperture(&whole.need("aperture")?, &mut draft)?;
    fields(&whole.need("fields")?, &mut draft)?;
    for (i, w) in whole.need("wavelengths")?.need("wavelengths")?.items()?.iter().enumerate() {
        let unit = match w.get("unit").map(|u| u.text()).transpose()?.unwrap_or("um") {
            "um" => 1e3,
            "nm" => 1.0,
            "mm" => 1e6,
            other => return Err(w.refused(format!("the unit `{}`", shown(other)), "nm, um, mm")),
        };
        let weight = w.get("weight").map(|x| x.number()).transpose()?.unwrap_or(1.0);
        draft.wavelengths.push((w.need("value")?.number()? * unit, weight));
        if w.is_true("is_primary") {
            draft.primary = i;
        }
    }
    for key in ["pickups", "solves"] {
        let list = whole.get(key).map(|p| p.get(key).map_or(p.value.clone(), |inner| inner.value.clone()));
        if list.is_some_and(|l| l.as_array().is_some_and(|a| !a.is_empty())) {
            draft.notes.push(format!("{key} are kept as their values"));
        }
    }
    surfaces(&whole.need("surface_group")?.need("surfaces")?, &mut draft)?;
    // The size of the stop stands with the aperture where it is what is stated.
    if let Some(stop) = draft.surfaces.iter_mut().find(|s| s.stop) {
        stop.semi_diameter = stop_mm.map(|diameter| 0.5 * diameter).or(stop.semi_diameter);
    }
    Ok(draft)
}

/// Takes the aperture; of one that is the stop's, its diameter, mm.
fn aperture(part: &Part, draft: &mut Draft) -> Result<Option<f64>> {
    let kind = part.get("type").or_else(|| part.get("ap_type"));
    let kind = kind.ok_or_else(|| part.refused("no key `type`", "EPD, imageFNO, objectNA, float_by_stop_size"))?;
    let value = part.need("value")?.number()?;
    draft.aperture = Some(match kind.text()? {
        "EPD" => Size::EntrancePupil(value),
        "imageFNO" => Size::FNumber(value),
        "objectNA" => Size::ObjectAperture(value),
        "float_by_stop_size" => Size::Stop,
        other => return Err(kind.refused(shown(other), "EPD, imageFNO, objectNA, float_by_stop_size")),
    });
    if part.is_true("object_space_telecentric") {
        draft.notes.push("telecentric object space: rays are aimed at the stop instead".into());
    }
    let stop = matches!(draft.aperture, Some(Size::Stop)) && value > 0.0;
    Ok(stop.then_some(value))
}

fn fields(part: &Part, draft: &mut Draft) -> Result<()> {
    // Newer files name the type by its class.
    let stated = part.get("field_definition").and_then(|d| d.get("field_type")).or_else(|| part.get("field_type"));
    let mut kind = stated.map(|k| k.text().map(str::to_owned)).transpose()?;
    let list = part.need("fields")?.items()?;
    for f in &list {
        let number = |key: &str| f.get(key).map(|x| x.number()).transpose().map(|x| x.unwrap_or(0.0));
        let (vx, vy) = (number("vx")?, number("vy")?);
        draft.points.push(Point { x: number("x")?, y: number("y")?, decentre: [0.0; 2], compression: [vx, vy] });
        let own = f.get("field_type").map(|k| k.text().map(str::to_owned)).transpose()?;
        if let (Some(own), Some(first)) = (&own, &kind)
            && own != first
        {
            return Err(f.refused(format!("field type {}", shown(own)), "one type for all fields"));
        }
        kind = kind.or(own);
    }
    draft.field = match kind.as_deref() {
        None | Some("angle" | "AngleField") => FieldKind::Angle,
        Some("object_height" | "ObjectHeightField") => FieldKind::ObjectHeight,
        Some("paraxial_image_height" | "ParaxialImageHeightField") => FieldKind::ParaxialImageHeight,
        Some("real_image_height" | "RealImageHeightField") => FieldKind::ImageHeight,
        Some(other) => {
            return Err(part.refused(
                format!("field type {}", shown(other)),
                "angle, object_height, paraxial_image_height, real_image_height",
            ));
        }
    };
    Ok(())
}

fn surfaces(part: &Part, draft: &mut Draft) -> Result<()> {
    let list = part.items()?;
    if list.len() > MAX_SURFACES + 2 {
        return Err(part.refused(format!("{} surfaces", list.len()), "at most 400"));
    }
    let [object, middle @ .., image] = &list[..] else {
        return Err(part.refused(format!("{} surfaces", list.len()), "an object, at least one surface, an image"));
    };
    if middle.is_empty() {
        return Err(part.refused("2 surfaces", "an object, at least one surface, an image"));
    }
    let z = |s: &Part| -> Result<f64> { s.need("geometry")?.need("cs")?.need("z")?.any_number() };
    let mut places = Vec::new();
    for s in middle.iter().chain([image]) {
        let here = z(s)?;
        if !here.is_finite() {
            return Err(s.refused(here.to_string(), "a finite place"));
        }
        places.push(here);
    }
    draft.object_mm = places[0] - z(object)?;
    let geometry = object.need("geometry")?;
    let radius = geometry.get("radius").map(|r| r.any_number()).transpose()?.filter(|r| r.is_finite());
    if !["Plane", "StandardGeometry"].contains(&geometry.need("type")?.text()?) || radius.is_some() {
        draft.notes.push(format!(
            "{}: the object is curved: object points are taken on the plane through its vertex",
            object.path
        ));
    }
    if let Some(behind) = object.get("material_post") {
        draft.object_medium = medium(&behind)?;
    }
    for (i, s) in middle.iter().enumerate() {
        let mut stage = surface(s)?;
        stage.thickness = places[i + 1] - places[i];
        draft.surfaces.push(stage);
    }
    image_surface(image, draft)
}

/// Form of the image.
fn image_surface(image: &Part, draft: &mut Draft) -> Result<()> {
    let (geometry, place) = (image.need("geometry")?, Location::called(image.path.as_str()));
    on_axis(&geometry.need("cs")?)?;
    let number = |key: &str| geometry.get(key).map(|x| x.any_number()).transpose();
    let (radius, conic) = (number("radius")?.unwrap_or(f64::INFINITY), number("conic")?.unwrap_or(0.0));
    let kind = geometry.need("type")?.text()?.to_owned();
    match kind.as_str() {
        "Plane" => return Ok(()),
        "StandardGeometry" => {}
        "EvenAsphere" | "OddAsphere" => {
            let list = geometry.get("coefficients").or_else(|| geometry.get("c")).map(|c| c.items()).transpose()?;
            let terms = list.unwrap_or_default().iter().map(|c| c.number()).collect::<Result<Vec<f64>>>()?;
            if terms.iter().any(|a| *a != 0.0) {
                draft.notes.push(format!("{place}: terms of the image's form beyond its conic are left out"));
            }
        }
        other => {
            let found = format!("an image of type {}", shown(other));
            return Err(geometry.refused(found, "Plane, StandardGeometry, EvenAsphere, OddAsphere"));
        }
    }
    if radius.is_finite() {
        draft.curve_image(&place, ImageSurface { curvature: radius.recip(), conic });
    }
    Ok(())
}

/// Refuses a frame that is shifted or turned.
fn on_axis(frame: &Part) -> Result<()> {
    for key in ["x", "y", "rx", "ry", "rz"] {
        let moved = frame.get(key).map(|x| x.number()).transpose()?.unwrap_or(0.0);
        if moved != 0.0 {
            return Err(frame
                .refused(format!("{key} = {moved}"), "surfaces on one axis; tilts and decentres go in a TOML file"));
        }
    }
    Ok(())
}

fn surface(part: &Part) -> Result<Stage> {
    let mut stage = Stage::plane(Location::called(part.path.as_str()));
    let geometry = part.need("geometry")?;
    on_axis(&geometry.need("cs")?)?;
    // What a surface does to light stands with it, or in newer files in a part of its own.
    let interaction = part.get("interaction_model");
    if part.is_true("is_reflective") || interaction.as_ref().is_some_and(|i| i.is_true("is_reflective")) {
        return Err(part.refused("a mirror", "refracting surfaces"));
    }
    for does in [part.get("surface_type"), interaction.as_ref().and_then(|i| i.get("type"))].into_iter().flatten() {
        let name = does.value.as_str().unwrap_or_default();
        let thin = ["paraxial", "ThinLensInteractionModel", "thin_lens"].contains(&name);
        if !thin && !["", "standard", "RefractiveReflectiveModel", "refractive_reflective"].contains(&name) {
            return Err(does.refused(format!("`{}`", shown(name)), "refracting surfaces, thin lenses"));
        }
        if thin && stage.shape.ideal.is_none() {
            let stated = interaction.as_ref().and_then(|i| i.get("focal_length")).or_else(|| part.get("f"));
            let stated = stated.ok_or_else(|| part.refused("no focal length of a thin lens", "focal_length"))?;
            stage.shape.ideal = Some(stated.number()?);
        }
    }
    if let Some(coating) = interaction.as_ref().and_then(|i| i.get("bsdf")).filter(|b| !b.value.is_null()) {
        return Err(coating.refused("scattering", "surfaces that refract alone"));
    }
    stage.stop = part.is_true("is_stop");
    stage.shape.curvature = geometry.get("radius").map(|r| r.any_number()).transpose()?.map_or(0.0, f64::recip);
    stage.shape.conic = geometry.get("conic").map(|k| k.number()).transpose()?.unwrap_or(0.0);
    let coefficients = |least: usize| -> Result<Vec<f64>> {
        let list = geometry.get("coefficients").or_else(|| geometry.get("c")).map(|c| c.items()).transpose()?;
        let mut terms = Vec::new();
        for c in list.unwrap_or_default() {
            terms.push(c.number()?);
        }
        if terms.len() > 20 - least + 1 {
            return Err(geometry.refused(format!("{} coefficients", terms.len()), "terms up to r²⁰"));
        }
        Ok(terms)
    };
    match geometry.need("type")?.text()? {
        "Plane" => stage.shape.curvature = 0.0,
        "StandardGeometry" => {}
        "EvenAsphere" => {
            stage.shape.asphere = coefficients(2)?;
            if stage.shape.asphere.len() > 10 {
                return Err(geometry.refused(format!("{} coefficients", stage.shape.asphere.len()), "terms up to r²⁰"));
            }
        }
        "OddAsphere" => {
            // Coefficients of r, r², r³, …
            for (i, a) in coefficients(1)?.into_iter().enumerate() {
                match i + 1 {
                    1 if a == 0.0 => {}
                    1 => return Err(geometry.refused(format!("a term {a} r"), "terms from r² on")),
                    power if power % 2 == 0 => put(&mut stage.shape.asphere, power / 2 - 1, a),
                    power => put(&mut stage.shape.odd, power / 2 - 1, a),
                }
            }
        }
        other => {
            let found = format!("a surface of type {}", shown(other));
            return Err(geometry.refused(found, "Plane, StandardGeometry, EvenAsphere, OddAsphere"));
        }
    }
    stage.medium = medium(&part.need("material_post")?)?;
    if let Some(aperture) = part.get("aperture") {
        stage.semi_diameter = clear(&aperture)?;
    }
    Ok(stage)
}

fn put(list: &mut Vec<f64>, at: usize, value: f64) {
    if list.len() <= at {
        list.resize(at + 1, 0.0);
    }
    list[at] = value;
}

fn clear(part: &Part) -> Result<Option<f64>> {
    let number = |key: &str| part.get(key).map(|x| x.any_number()).transpose();
    if let (Some(most), least) = (number("r_max")?, number("r_min")?.unwrap_or(0.0)) {
        if least > 0.0 {
            return Err(part
                .refused(format!("an annular aperture from {least} to {most}"), "a circular aperture about the axis"));
        }
        return Ok(Some(most).filter(|r| r.is_finite() && *r > 0.0));
    }
    Err(part.refused("an aperture that is not circular", "a circular aperture about the axis"))
}

fn medium(part: &Part) -> Result<Stated> {
    match part.need("type")?.text()? {
        "IdealMaterial" => {
            let n = part.need("index")?.number()?;
            Ok(if n == 1.0 { Stated::Air } else { Stated::Constant(n) })
        }
        "AbbeMaterial" => {
            let number = |key: &str| -> Result<f64> { part.need(key)?.number() };
            Ok(Stated::Lines { n_d: number("index")?, v_d: number("abbe")? })
        }
        "Material" => {
            let name = part.need("name")?.text()?;
            // The file of the index database names the maker.
            let path = part.get("filename").or_else(|| part.get("reference")).and_then(|f| f.value.as_str());
            let maker = path.and_then(|p| p.rsplit(['/', '\\']).nth(1)).map(str::to_ascii_uppercase);
            Ok(Stated::Glass(maker.map_or_else(|| name.to_owned(), |m| format!("{m}/{name}"))))
        }
        "Mirror" => Err(part.refused("a mirror", "refracting surfaces")),
        other => {
            Err(part.refused(format!("a material of type {}", shown(other)), "IdealMaterial, AbbeMaterial, Material"))
        }
    }
}
