//! Placement of a picture in a window.

/// A rectangle of whole pixels: from the upper left corner to the one behind the lower right.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Area {
    /// Left, top.
    pub min: (i32, i32),
    /// Right, bottom.
    pub max: (i32, i32),
}

impl Area {
    /// Its columns.
    pub fn width(self) -> i32 {
        self.max.0 - self.min.0
    }

    /// Its rows.
    pub fn height(self) -> i32 {
        self.max.1 - self.min.1
    }

    /// Returns true if it has no pixel.
    pub fn is_empty(self) -> bool {
        self.width() <= 0 || self.height() <= 0
    }
}

/// The largest area of the picture's shape in the middle of a window.
pub fn fit(picture: (u32, u32), window: (u32, u32)) -> Area {
    let w = u64::from(picture.0.max(1));
    let h = u64::from(picture.1.max(1));
    let across = u64::from(window.0);
    let down = u64::from(window.1);
    let (width, height) = if across * h <= down * w { (across, across * h / w) } else { (down * w / h, down) };
    let left = ((across - width) / 2) as i32;
    let top = ((down - height) / 2) as i32;
    Area { min: (left, top), max: (left + width as i32, top + height as i32) }
}

/// A part of a picture and where it is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Part {
    /// Area of the picture.
    pub from: Area,
    /// Area of the window.
    pub to: Area,
}

/// The left part of one picture and the right part of another of the same size, cut at a share of the width.
pub fn split(picture: (u32, u32), window: (u32, u32), at: f32) -> [Part; 2] {
    let whole = fit(picture, window);
    let width = picture.0 as i32;
    let height = picture.1 as i32;
    let cut = ((at.clamp(0.0, 1.0) * width as f32).round() as i32).clamp(0, width);
    let shown = whole.min.0 + (i64::from(cut) * i64::from(whole.width()) / i64::from(width.max(1))) as i32;
    let part = |from: (i32, i32), to: (i32, i32)| Part {
        from: Area { min: (from.0, 0), max: (from.1, height) },
        to: Area { min: (to.0, whole.min.1), max: (to.1, whole.max.1) },
    };
    [part((0, cut), (whole.min.0, shown)), part((cut, width), (shown, whole.max.0))]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_of_the_window_fills_it_and_another_lies_in_its_middle() {
        assert_eq!(fit((64, 48), (64, 48)), Area { min: (0, 0), max: (64, 48) });
        assert_eq!(fit((64, 48), (100, 48)), Area { min: (18, 0), max: (82, 48) });
        assert_eq!(fit((32, 24), (64, 60)), Area { min: (0, 6), max: (64, 54) });
        assert!(fit((64, 48), (0, 48)).is_empty());
    }

    #[test]
    fn two_parts_meet_and_cover_the_picture_once() {
        for at in [0.0, 0.3, 0.5, 1.0, 7.0] {
            let [left, right] = split((64, 48), (130, 96), at);
            assert_eq!((left.from.max.0, left.to.max.0), (right.from.min.0, right.to.min.0));
            assert_eq!((left.from.min.0, right.from.max.0, left.to.min.0, right.to.max.0), (0, 64, 1, 129));
        }
        let [left, right] = split((64, 48), (64, 48), 0.25);
        assert_eq!((left.from, left.to), (left.to, left.from));
        assert_eq!(right.from.min.0, 16);
    }
}
