//! Times of frames, and what limits their rate.

use std::collections::VecDeque;

use runtime::executor::PassTime;

use crate::state::DIVISORS;

/// Frames that are kept for the graph.
const KEPT: usize = 240;
/// Passes of the pixels; all others belong to the light update.
const PIXEL_PASSES: [&str; 3] = ["shade", "mark", "display"];

/// Frames that take too long before pixels become fewer: a single one is a hitch.
const CERTAIN: u32 = 2;
/// Pixels of half the divisor for one of now, and the share of a budget that their frames may take as it is foreseen.
const FINER_PIXELS: u32 = 4;
const ROOM: f64 = 0.9;

/// Times of a frame, ms.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FrameTimes {
    /// Time of each kind of pass.
    pub passes: Vec<(String, f64)>,
    /// From the frame before to this one.
    pub total: f64,
}

impl FrameTimes {
    /// A frame whose passes took so long.
    pub fn new(passes: Vec<PassTime>, total: f64) -> Self {
        Self { passes: patchlight::light::by_name(passes), total }
    }

    /// The light update.
    pub fn update(&self) -> f64 {
        self.sum(|name| !PIXEL_PASSES.contains(&name))
    }

    /// The pixels.
    pub fn shading(&self) -> f64 {
        self.sum(|name| PIXEL_PASSES.contains(&name))
    }

    /// Everything else: panels, transfers, the window system.
    pub fn presenting(&self) -> f64 {
        (self.total - self.update() - self.shading()).max(0.0)
    }

    fn sum(&self, is_meant: impl Fn(&str) -> bool) -> f64 {
        // An empty sum of floats is −0.
        self.passes.iter().filter(|(name, _)| is_meant(name)).fold(0.0, |sum, (_, ms)| sum + ms)
    }
}

/// Pixels of what moves: as many as let a rate be kept.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pace {
    /// Pixels of the window for one of the picture, along an edge.
    pub divisor: u32,
    /// Size of the last picture.
    size: (u32, u32),
    /// Frames that took too long since the last that did not.
    slow: u32,
}

impl Pace {
    /// Takes note of a frame of what moves, of so many ms and with a picture of this size: fewer pixels where frames
    /// take longer than `budget` ms one after the other, more where those would fit.
    pub fn follow(&mut self, budget: f64, frame: &FrameTimes, ms: f64, size: (u32, u32)) {
        // The first picture of a size pays for its buffers.
        if std::mem::replace(&mut self.size, size) != size {
            self.slow = 0;
            return;
        }
        let finer = ms + frame.shading() * f64::from(FINER_PIXELS - 1);
        if ms > budget {
            self.slow += 1;
            if self.slow >= CERTAIN {
                self.slow = 0;
                self.divisor = (2 * self.divisor).min(DIVISORS[DIVISORS.len() - 1]);
            }
        } else {
            self.slow = 0;
            if finer < ROOM * budget {
                self.divisor = (self.divisor / 2).max(1);
            }
        }
    }
}

impl Default for Pace {
    fn default() -> Self {
        Self { divisor: 1, size: (0, 0), slow: 0 }
    }
}

/// Times of the last frames with a new picture, and sums over all of them.
#[derive(Clone, Debug, Default)]
pub struct Times {
    last: VecDeque<FrameTimes>,
    frames: u32,
    /// Update, shading, presenting, ms.
    sums: [f64; 3],
    longest: f64,
}

/// Over all frames with a new picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rate {
    /// Number of pictures.
    pub frames: u32,
    /// Pictures a second.
    pub per_second: f64,
    /// Mean times of the light update, of shading and of presenting, ms.
    pub means: [f64; 3],
    /// Longest frame, ms.
    pub longest: f64,
}

impl Times {
    /// Adds a frame.
    pub fn add(&mut self, frame: FrameTimes) {
        for (sum, ms) in self.sums.iter_mut().zip([frame.update(), frame.shading(), frame.presenting()]) {
            *sum += ms;
        }
        self.frames += 1;
        self.longest = self.longest.max(frame.total);
        if self.last.len() == KEPT {
            self.last.pop_front();
        }
        self.last.push_back(frame);
    }

    /// The last frames, oldest first.
    pub fn last(&self) -> &VecDeque<FrameTimes> {
        &self.last
    }

    /// Over all frames; none before the first.
    pub fn rate(&self) -> Option<Rate> {
        let frames = f64::from(self.frames);
        let total: f64 = self.sums.iter().sum();
        (total > 0.0).then(|| Rate {
            frames: self.frames,
            per_second: 1e3 * frames / total,
            means: self.sums.map(|sum| sum / frames),
            longest: self.longest,
        })
    }
}

impl Rate {
    /// The limit of the rate, in a line.
    pub fn summary(&self) -> String {
        let Self { frames, per_second, means, longest } = self;
        let total: f64 = means.iter().sum();
        let part = |name: &str, ms: f64| format!("{name} {ms:.1} ms ({:.0} %)", 100.0 * ms / total);
        format!(
            "{frames} pictures, {per_second:.1} a second, longest {longest:.0} ms: {}, {}, {}",
            part("light update", means[0]),
            part("shading", means[1]),
            part("presenting", means[2])
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames of pictures 640 pixels wide at divisor 1: `light` ms and so many for all pixels.
    fn divisor_after(pace: &mut Pace, frames: u32, light: f64, pixels: f64) -> u32 {
        for _ in 0..frames {
            let size = (640 / pace.divisor, 360 / pace.divisor);
            let shading = pixels / f64::from(pace.divisor * pace.divisor);
            let passes = vec![PassTime::of_host("direct", light), PassTime::of_host("shade", shading)];
            let frame = FrameTimes::new(passes, light + shading);
            pace.follow(40.0, &frame, light + shading, size);
        }
        pace.divisor
    }

    #[test]
    fn pictures_have_as_many_pixels_as_their_rate_allows() {
        let mut pace = Pace::default();
        assert_eq!(divisor_after(&mut pace, 20, 15.0, 56.0), 2, "15 + 14 ms fit, 71 do not");
        // Quick pixels all fit. Slow ones, or light that is too slow by itself, leave the fewest.
        assert_eq!(divisor_after(&mut pace, 20, 15.0, 10.0), 1);
        assert_eq!(divisor_after(&mut pace, 20, 15.0, 300.0), 4);
        assert_eq!(divisor_after(&mut pace, 20, 60.0, 10.0), 4);
        assert_eq!(divisor_after(&mut pace, 20, 5.0, 25.0), 1);
    }

    #[test]
    fn a_single_slow_frame_takes_no_pixels() {
        let mut pace = Pace::default();
        assert_eq!(divisor_after(&mut pace, 3, 5.0, 20.0), 1);
        assert_eq!(divisor_after(&mut pace, 1, 200.0, 20.0), 1);
        assert_eq!(divisor_after(&mut pace, 3, 5.0, 20.0), 1);
        assert_eq!(divisor_after(&mut pace, 2, 200.0, 20.0), 2);
    }

    #[test]
    fn shares_of_a_frame_add_up_to_its_time() {
        let pass = |name: &str, milliseconds| PassTime::of_host(name, milliseconds);
        let passes = vec![pass("direct", 2.0), pass("shade", 5.0), pass("method", 1.0), pass("shade", 3.0)];
        let frame = FrameTimes::new(passes, 20.0);
        assert_eq!((frame.update(), frame.shading(), frame.presenting()), (3.0, 8.0, 9.0));
        let mut times = Times::default();
        assert!(times.rate().is_none());
        for _ in 0..KEPT + 10 {
            times.add(frame.clone());
        }
        let rate = times.rate().unwrap();
        assert_eq!((rate.frames, times.last().len()), (KEPT as u32 + 10, KEPT));
        assert!((rate.per_second - 50.0).abs() < 1e-9);
        let words = rate.summary();
        assert!(words.contains("50.0 a second") && words.contains("shading 8.0 ms (40 %)"), "{words}");
    }
}
