"""What accuracy costs in time: before a run, after it, and compared between settings.

The web page and other callers need three calls:

    forecaster = Forecaster(device)          # keep it: it remembers how fast this machine is
    stops = forecaster.stops(gaussians, scene)
    # {"draft": Stop, "standard": Stop, "fine": Stop}; each has
    #   .seconds   predicted seconds of particles, simulation, shapes, pictures, video, saving
    #   .error     error measured for such scenes, a fraction of the size; .pixels in the picture;
    #              None where it was not measured, .promise.why says so
    #   .caveat    None, or a sentence: why the seconds are a guess
    #   .forecast  the whole Forecast (seconds by stage, particles, substeps)

    forecast = forecaster.forecast(gaussians, scene)   # one setting, scene.accuracy
    forecast.compared(spent)                           # predicted, spent, ratio by stage

`gaussians` are those that the generator made (any size). The first call takes a few seconds; a
second one with the same Gaussians and law takes a fraction of a second. The report of a run with a
forecaster has the comparison under "forecast".

    report = study.Study(gaussians, scene).run()    # levels, errors: see `phy124 accuracy`
    pipeline.generate(..., goal=choose.Goal.error("2px"))    # or "1%", "3mm", Goal.time(20)

The modules: `problems` and `verify` (known solutions), `convergence` (orders, Richardson),
`forecast`, `difference` (two clips in millimetres and pixels), `study`, `choose`, `plots`.
"""

from phy124.accuracy.forecast import Forecast, Forecaster, Stop

__all__ = ["Forecast", "Forecaster", "Stop"]
