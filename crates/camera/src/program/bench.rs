//! `--bench`: where the time of a reconstruction goes.

use std::time::Duration;

use crate::reconstruct::Times;

/// The figures of one capture.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Figures {
    pub(crate) decode: Duration,
    pub(crate) times: Times,
    pub(crate) write: Duration,
    pub(crate) megapixels: f64,
    pub(crate) tiles: usize,
    /// Tiles that the runtime works on at a time.
    pub(crate) workers: usize,
}

impl Figures {
    /// As text, one line a stage.
    pub(crate) fn text(&self) -> String {
        let ms = |d: Duration| d.as_secs_f64() * 1e3;
        let all = self.decode + self.times.input + self.times.network + self.times.finish + self.write;
        let mut lines = vec![
            format!("decode RAW          {:9.1} ms", ms(self.decode)),
            format!("levels to demosaic  {:9.1} ms", ms(self.times.input)),
        ];
        if self.tiles > 0 {
            lines.push(format!(
                "network             {:9.1} ms   {} tiles of {:.1} ms, {:.2} Mpixel/s, {:.1} % of it in the runtime",
                ms(self.times.network),
                self.tiles,
                ms(self.times.runtime) / self.tiles as f64,
                self.network_megapixels_per_second(),
                100.0 * self.in_runtime(),
            ));
        }
        lines.push(format!("undistort to colour {:9.1} ms", ms(self.times.finish)));
        lines.push(format!("write               {:9.1} ms", ms(self.write)));
        let rate = self.megapixels / all.as_secs_f64();
        lines.push(format!(
            "all                 {:9.1} ms   {:.2} Mpixel, {rate:.2} Mpixel/s",
            ms(all),
            self.megapixels
        ));
        lines.join("\n")
    }

    /// For `--json`.
    pub(crate) fn json(&self) -> serde_json::Value {
        serde_json::json!({
            "decode_s": self.decode.as_secs_f64(),
            "input_s": self.times.input.as_secs_f64(),
            "network_s": self.times.network.as_secs_f64(),
            "runtime_s": self.times.runtime.as_secs_f64(),
            "tiles": self.tiles,
            "tile_s": if self.tiles > 0 { self.times.runtime.as_secs_f64() / self.tiles as f64 } else { 0.0 },
            "finish_s": self.times.finish.as_secs_f64(),
            "write_s": self.write.as_secs_f64(),
            "megapixels": self.megapixels,
            "network_megapixels_per_second": self.network_megapixels_per_second(),
        })
    }

    fn network_megapixels_per_second(&self) -> f64 {
        if self.tiles > 0 { self.megapixels / self.times.network.as_secs_f64() } else { 0.0 }
    }

    /// Share of the network's time spent in the runtime itself.
    fn in_runtime(&self) -> f64 {
        self.times.runtime.as_secs_f64() / (self.times.network.as_secs_f64() * self.workers as f64)
    }
}
