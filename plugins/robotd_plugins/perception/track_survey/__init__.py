"""`track_survey`: surveys the first lap by scan-matched odometry, until the lap has met its own beginning."""

from robotd_plugins.perception.track_survey.config import TrackSurveyConfig
from robotd_plugins.perception.track_survey.perceptor import Sees, TrackSurveyor

__all__ = ["Sees", "TrackSurveyConfig", "TrackSurveyor"]
