//! `isoplanat-camera`: RAW captures in, pictures out, through a kit's network; its code is the crate `isoplanat-camera`.

fn main() -> std::process::ExitCode {
    isoplanat_camera::program::main()
}
