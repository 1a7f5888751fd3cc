//! `isoplanat-camera`: RAW captures in, pictures out, through a kit's network; its code is the crate `isoplanat-camera`.

/// Where memory is refused, one line and exit code 2.
#[global_allocator]
static MEMORY: isoplanat_camera::Refusing = isoplanat_camera::Refusing;

fn main() -> std::process::ExitCode {
    isoplanat_camera::program::main()
}
