#![no_main]

isoplanat_fuzz::fuzz!();
