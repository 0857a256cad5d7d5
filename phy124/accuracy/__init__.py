"""Error and time of a run: forecasts, promised errors, and the choice of an accuracy for a goal.

The web page and other callers need three calls:

    forecaster = Forecaster(context)         # keep it: it caches measurements of this machine
    stops = forecaster.stops(gaussians, scene)
    # {"draft": Stop, "standard": Stop, "fine": Stop}; each has
    #   .seconds   predicted seconds of particles, simulation, shapes, pictures, video, saving
    #   .error     error measured for such scenes, a fraction of the size; .pixels in the picture;
    #              None where it was not measured, .promise.why says so
    #   .caveat    None, or a sentence: why the seconds are a guess
    #   .forecast  the whole Forecast (seconds by stage, particles, substeps)

    forecast = forecaster.forecast(gaussians, scene)   # one setting, scene.accuracy
    forecast.compare(spent)                            # predicted, spent, ratio by stage

`gaussians` are the generator's output, of any size. The first call takes a few seconds; a second
call with the same Gaussians and law takes a fraction of a second. The report of a run with a
forecaster has the comparison under "forecast".

    pipeline.generate(..., goal=choose.Goal.error("2px"))    # or "1%", "3mm", Goal.time(20)
"""

from phy124.accuracy.forecast import Forecast, Forecaster, Stop

__all__ = ["Forecast", "Forecaster", "Stop"]
