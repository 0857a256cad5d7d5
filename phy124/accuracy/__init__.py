"""Predicts the time and the error of a run, and chooses an accuracy that meets a goal.

The web page and other callers need three calls:

    forecaster = Forecaster(context)         # reuse it: it caches measurements of this machine
    stops = forecaster.stops(gaussians, scene)
    # {"draft": Stop, "standard": Stop, "fine": Stop}; each has
    #   .seconds   predicted time of particles, simulation, shapes, rendering, video and saving [s]
    #   .error     error bound as a fraction of the object's size, from measured similar scenes;
    # None if no similar scene was measured; .promise.why has the reason
    #   .pixels    the error bound in the video [pixels], or None
    #   .caveat    None, or the reason why the predicted time is only a guess
    #   .forecast  the whole Forecast (seconds by stage, particles, substeps)

    forecast = forecaster.forecast(gaussians, scene)   # for the accuracy in scene.accuracy
    forecast.compare(spent)                            # predicted, spent, ratio by stage

`gaussians` are the generator's output, at any scale. The first call takes a few seconds. A second
call with the same Gaussians and material law takes a fraction of a second. If a run has a
forecaster, its report contains the comparison of predicted and measured times under "forecast".

`pipeline.generate(..., goal=choose.Goal.error("2px"))` makes a run whose error is at most two
pixels. Other goals are "1%", "3mm", and `Goal.time(20)`.
"""

from phy124.accuracy.forecast import Forecast, Forecaster, Stop

__all__ = ["Forecast", "Forecaster", "Stop"]
