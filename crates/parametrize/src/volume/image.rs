//! Chooses one image from a file with several channels or time points.

use std::path::Path;

use crate::error::ParametrizeError;

/// The image to read from a file that contains several images.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ImageChoice {
    /// Number of the channel, from 1. Default `None`: the only channel.
    pub channel: Option<usize>,
    /// Number of the time point, from 1. Default `None`: the only time point.
    pub time: Option<usize>,
}

impl ImageChoice {
    /// Returns the indices, from 0, of the chosen channel and time point in a file with `channels` channels and `times`
    /// time points.
    ///
    /// # Errors
    ///
    /// [`ParametrizeError::SeveralImages`] if there are several channels or time points and none is chosen, or if the
    /// chosen one doesn't exist.
    pub(super) fn indices(self, path: &Path, channels: usize, times: usize) -> Result<[usize; 2], ParametrizeError> {
        let index = |chosen: Option<usize>, count: usize| match chosen {
            None if count == 1 => Some(0),
            None => None,
            Some(number) => number.checked_sub(1).filter(|index| *index < count),
        };
        match (index(self.channel, channels), index(self.time, times)) {
            (Some(channel), Some(time)) => Ok([channel, time]),
            _ => Err(ParametrizeError::SeveralImages { path: path.to_owned(), channels, times, chosen: self }),
        }
    }
}

impl std::fmt::Display for ImageChoice {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match (self.channel, self.time) {
            (None, None) => f.write_str("no channel or time"),
            (Some(channel), None) => write!(f, "channel {channel}"),
            (None, Some(time)) => write!(f, "time {time}"),
            (Some(channel), Some(time)) => write!(f, "channel {channel}, time {time}"),
        }
    }
}
