"""What accuracy costs in time: before a run, after it, and how the settings compare.

For the web page and other callers, three calls:

    forecaster = Forecaster(device)          # keep one: it remembers how fast this machine is
    stops = forecaster.stops(gaussians, scene)
    # {"draft": Stop, "standard": Stop, "fine": Stop}; each has
    #   .seconds   predicted seconds of particles, simulation, shapes, pictures, video, saving
    #   .error     error measured for such scenes, a fraction of the size; .pixels in the picture;
    #              None where it was not measured, .promise.why says so
    #   .caveat    None, or a sentence: why the seconds are a guess
    #   .forecast  the whole Forecast (seconds by stage, particles, substeps)

    forecast = forecaster.forecast(gaussians, scene)   # one setting, scene.accuracy
    forecast.compared(spent)                           # predicted, spent, ratio by stage

`gaussians` are those that the generator made (any size). The first call takes a few seconds, a
second one with the same Gaussians and law a fraction of one. The report of a run with a forecaster
carries the comparison under "forecast".

    report = study.Study(gaussians, scene).run()    # levels, errors: see `phy124 accuracy`
    pipeline.generate(..., goal=choose.Goal.error("2px"))    # or "1%", "3mm", Goal.time(20)

The parts: `problems` and `verify` (answers that are known), `convergence` (orders, Richardson),
`forecast`, `difference` (two clips in millimetres and pixels), `study`, `choose`, `plots`.
"""

from phy124.accuracy.forecast import Forecast, Forecaster, Stop

__all__ = ["Forecast", "Forecaster", "Stop"]
