//! The facts of the exposure, as the decoder found them.

use rawler::formats::tiff::{Rational, SRational};

use isoplanat_imaging::exif::{Directory, Exif, Value, tags};

/// What the decoder found of the exposure's facts.
pub(super) fn facts_of(found: Option<&rawler::exif::Exif>, make: &str, model: &str) -> Exif {
    use Directory::{Exposure, Picture, Place};
    let mut facts = Exif::default();
    let text = |v: &Option<String>| v.clone().map(Value::Text);
    let short = |v: Option<u16>| v.map(Value::Short);
    let ratio = |v: &Option<Rational>| v.as_ref().map(|r| Value::Ratios(vec![[r.n, r.d]]));
    let signed = |v: &Option<SRational>| v.as_ref().map(|r| Value::SignedRatios(vec![[r.n, r.d]]));
    let three =
        |v: &Option<[Rational; 3]>| v.as_ref().map(|all| Value::Ratios(all.iter().map(|r| [r.n, r.d]).collect()));
    let mut put = |directory, entries: Vec<(u16, Option<Value>)>| {
        entries.into_iter().for_each(|(tag, v)| {
            if let Some(v) = v {
                facts.set(directory, tag, v);
            }
        });
    };
    put(Picture, vec![(tags::MAKE, Some(Value::Text(make.into()))), (tags::MODEL, Some(Value::Text(model.into())))]);
    let Some(e) = found else { return facts };
    put(Picture, vec![(0x013b, text(&e.artist)), (0x8298, text(&e.copyright)), (0x0132, text(&e.modify_date))]);
    // Which of the two is named has to be there.
    let sensitivity = e.sensitivity_type.filter(|kind| match kind {
        2 => e.recommended_exposure_index.is_some(),
        3 => e.iso_speed.is_some(),
        6 => e.recommended_exposure_index.is_some() && e.iso_speed.is_some(),
        _ => false,
    });
    let lens_spec = e.lens_spec.as_ref().map(|all| Value::Ratios(all.iter().map(|r| [r.n, r.d]).collect()));
    put(
        Exposure,
        vec![
            (tags::EXPOSURE_TIME, ratio(&e.exposure_time)),
            (tags::F_NUMBER, ratio(&e.fnumber)),
            (0x8822, short(e.exposure_program)),
            (tags::ISO, short(e.iso_speed_ratings)),
            (tags::SENSITIVITY_TYPE, short(sensitivity)),
            (tags::EXPOSURE_INDEX, e.recommended_exposure_index.map(Value::Long)),
            (tags::ISO_LONG, e.iso_speed.map(Value::Long)),
            (tags::TAKEN, text(&e.date_time_original)),
            (0x9004, text(&e.create_date)),
            (0x9010, text(&e.offset_time)),
            (0x9011, text(&e.offset_time_original)),
            (0x9012, text(&e.offset_time_digitized)),
            (0x9201, signed(&e.shutter_speed_value)),
            (0x9202, ratio(&e.aperture_value)),
            (0x9203, signed(&e.brightness_value)),
            (0x9204, signed(&e.exposure_bias)),
            (0x9205, ratio(&e.max_aperture_value)),
            (tags::SUBJECT_DISTANCE, ratio(&e.subject_distance)),
            (0x9207, short(e.metering_mode)),
            (0x9208, short(e.light_source)),
            (0x9209, short(e.flash)),
            (tags::FOCAL_LENGTH, ratio(&e.focal_length)),
            (0x9290, text(&e.sub_sec_time)),
            (0x9291, text(&e.sub_sec_time_original)),
            (0x9292, text(&e.sub_sec_time_digitized)),
            (0xa402, short(e.exposure_mode)),
            (0xa403, short(e.white_balance)),
            (0xa406, short(e.scene_capture_type)),
            (0xa430, text(&e.owner_name)),
            (0xa431, text(&e.serial_number)),
            (0xa432, lens_spec),
            (0xa433, text(&e.lens_make)),
            (tags::LENS_MODEL, text(&e.lens_model)),
            (0xa435, text(&e.lens_serial_number)),
        ],
    );
    let Some(g) = &e.gps else { return facts };
    put(
        Place,
        vec![
            (0x0001, text(&g.gps_latitude_ref)),
            (0x0002, three(&g.gps_latitude)),
            (0x0003, text(&g.gps_longitude_ref)),
            (0x0004, three(&g.gps_longitude)),
            (0x0005, g.gps_altitude_ref.map(|v| Value::Bytes(vec![v]))),
            (0x0006, ratio(&g.gps_altitude)),
            (0x0007, three(&g.gps_timestamp)),
            (0x0010, text(&g.gps_img_direction_ref)),
            (0x0011, ratio(&g.gps_img_direction)),
            (0x0012, text(&g.gps_map_datum)),
            (0x001d, text(&g.gps_date_stamp)),
        ],
    );
    facts
}
