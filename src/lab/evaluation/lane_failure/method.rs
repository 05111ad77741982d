//! The methods that are compared: metrics, forecasts and baselines.

use crate::calibration::survey::{Survey, SurveyFrame};
use crate::features::energies::BlockMeans;
use crate::lab::labelled::LabelledSurvey;
use crate::reference::gap::Metric;

/// Length of the window, seconds.
const WINDOW_S: f64 = 1.0;
/// Length of the window of the quicker forecast, seconds.
const SHORT_WINDOW_S: f64 = 0.4;
/// A method that gives a frame a score.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Method {
    /// A metric on all taps.
    Metric(Metric),
    /// The forecast `lane-risk`, where each kind of condition is judged by a forecast that was fitted on the other
    /// kinds.
    LaneRiskOfOtherKinds,
    /// The forecast over a shorter window.
    QuickLaneRisk,
    /// Mean of the energy map divided by its largest value, for each tap (the score of ThirdEye, Stocco et al. 2022).
    MeanAttention,
    /// Mean and standard deviation of the grey levels of the picture.
    BrightnessAndContrast,
}

impl Method {
    pub fn name(self) -> String {
        match self {
            Self::Metric(metric) => metric.to_string(),
            Self::LaneRiskOfOtherKinds => format!("{}, fitted on other kinds", Metric::LaneRisk),
            Self::QuickLaneRisk => format!("{}, window {SHORT_WINDOW_S} s", Metric::LaneRisk),
            Self::MeanAttention => "mean attention".to_owned(),
            Self::BrightnessAndContrast => "brightness and contrast".to_owned(),
        }
    }

    pub fn is_baseline(self) -> bool {
        matches!(
            self,
            Self::MeanAttention | Self::BrightnessAndContrast | Self::Metric(Metric::Paper)
        )
    }

    pub fn metric(self) -> Metric {
        match self {
            Self::Metric(metric) => metric,
            Self::LaneRiskOfOtherKinds | Self::QuickLaneRisk => Metric::LaneRisk,
            Self::MeanAttention | Self::BrightnessAndContrast => Metric::Mahalanobis,
        }
    }

    /// Length of its window, seconds.
    pub fn window_s(self) -> f64 {
        match self {
            Self::QuickLaneRisk => SHORT_WINDOW_S,
            _ => WINDOW_S,
        }
    }

    /// Names of the blocks that it uses.
    pub fn taps(self, taps: &[String]) -> Vec<String> {
        match self {
            Self::Metric(_) | Self::LaneRiskOfOtherKinds | Self::QuickLaneRisk => taps.to_vec(),
            Self::MeanAttention | Self::BrightnessAndContrast => vec![self.name()],
        }
    }

    /// A drive as the method sees it.
    pub fn survey(self, drive: &LabelledSurvey) -> Survey {
        let frames = drive.survey.frames.iter().zip(&drive.grey);
        Survey {
            source: drive.survey.source.clone(),
            times: drive.survey.times.clone(),
            frames: frames
                .map(|(frame, grey)| match frame {
                    Ok(frame) => Ok(self.frame(frame, *grey)),
                    Err(why) => Err(why.clone()),
                })
                .collect(),
            common_size: drive.survey.common_size,
        }
    }

    #[allow(clippy::cast_precision_loss)]
    fn frame(self, frame: &SurveyFrame, grey: [f64; 2]) -> SurveyFrame {
        let plain = |energy: Vec<f64>, peak: f64| SurveyFrame {
            maps: Vec::new(),
            peaks: vec![peak],
            means: vec![BlockMeans {
                activation: Vec::new(),
                energy,
            }],
        };
        match self {
            Self::Metric(metric) => SurveyFrame {
                maps: match metric.divergence() {
                    Some(_) => frame.maps.clone(),
                    None => Vec::new(),
                },
                ..frame.clone()
            },
            Self::LaneRiskOfOtherKinds | Self::QuickLaneRisk => {
                Self::Metric(Metric::LaneRisk).frame(frame, grey)
            }
            Self::MeanAttention => {
                let means = frame.maps.iter().zip(&frame.peaks).map(|(map, peak)| {
                    map.energy.iter().sum::<f64>() / (map.energy.len() as f64 * peak)
                });
                plain(means.collect(), 1.0)
            }
            Self::BrightnessAndContrast => plain(grey.to_vec(), 255.0),
        }
    }
}
