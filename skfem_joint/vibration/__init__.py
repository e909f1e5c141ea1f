"""Vibration of a mode or at a frequency, over amplitude.

`backbone` is frequency and damping over amplitude by slow `cycles` about the `stuck` structure, at
levels or at `amplitudes` of a point; `backbone_sensitivity` and `mode_rates` derive them.
`ring_down` is free vibration. `response` is steady vibration over frequency, a `response_curve` for
each level with its motion over the load, `linear_response` its limits without and with all slip,
and `coarse_model` a smaller model that makes it cheaper.
"""
