//! Where a network computes: the CPU with our own kernels, or a GPU through burn.

use std::str::FromStr;

use burn::tensor::Device;

use super::kernels::Level;
use super::layers::Way;
use isoplanat_base::error::{Error, Result};

/// A kind of device. GPUs come with the features `cuda` and `wgpu`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Compute {
    /// All cores of the CPU.
    #[default]
    Cpu,
    /// The first CUDA device (feature `cuda`).
    Cuda,
    /// The system's GPU by Vulkan, Metal or DirectX (feature `wgpu`).
    Wgpu,
}

impl Compute {
    /// Which code runs the network's operations: our kernels know the CPU only.
    pub(super) fn way(self) -> Way {
        if self == Self::Cpu { Level::detect().into() } else { Way::Burn }
    }

    /// The device, tried once with a small sum.
    ///
    /// # Errors
    /// A feature this build lacks, or a device that does not answer.
    pub(super) fn device(self) -> Result<Device> {
        match self {
            Self::Cpu => Ok(Device::flex()),
            #[cfg(feature = "cuda")]
            Self::Cuda => self.answering(Device::cuda(0)),
            #[cfg(feature = "wgpu")]
            Self::Wgpu => self.answering(Device::wgpu(burn::tensor::DeviceKind::DefaultDevice)),
            #[cfg(not(feature = "cuda"))]
            Self::Cuda => self.left_out(),
            #[cfg(not(feature = "wgpu"))]
            Self::Wgpu => self.left_out(),
        }
    }

    #[cfg(any(feature = "cuda", feature = "wgpu"))]
    fn answering(self, device: Device) -> Result<Device> {
        // The drivers' libraries panic where there is no device: that is bad input, not a fault of the program.
        let tried = std::panic::catch_unwind(|| {
            burn::tensor::Tensor::<1>::ones([4], &device).sum().into_data().try_into_vec::<f32>().ok()
        });
        if !matches!(tried, Ok(Some(sum)) if sum == [4.0]) {
            return Err(Error::bad("isoplanat", "device", self.name(), "no such device answers; cpu always works"));
        }
        Ok(device)
    }

    #[cfg(not(all(feature = "cuda", feature = "wgpu")))]
    fn left_out(self) -> Result<Device> {
        let name = self.name();
        let allowed = format!("this build has no feature `{name}`: use cpu, or build with --features {name}");
        Err(Error::bad("isoplanat", "device", name, allowed))
    }

    /// Whether it is there, before anything is made for it.
    ///
    /// # Errors
    /// A feature this build lacks, or a device that does not answer.
    pub fn require(self) -> Result<()> {
        self.device().map(drop)
    }

    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Cpu => "cpu",
            Self::Cuda => "cuda",
            Self::Wgpu => "wgpu",
        }
    }
}

impl FromStr for Compute {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        [Self::Cpu, Self::Cuda, Self::Wgpu]
            .into_iter()
            .find(|c| c.name() == text)
            .ok_or_else(|| "cpu, cuda or wgpu".to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn devices_are_known_by_name_and_missing_ones_are_refused() {
        for compute in [Compute::Cpu, Compute::Cuda, Compute::Wgpu] {
            assert_eq!(compute.name().parse(), Ok(compute));
        }
        assert!("tpu".parse::<Compute>().is_err());
        assert!(Compute::Cpu.device().is_ok());
        #[cfg(not(feature = "cuda"))]
        assert!(Compute::Cuda.device().expect_err("no feature").to_string().contains("--features cuda"));
    }
}
