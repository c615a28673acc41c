"""Learning: where to push. Torch is needed for training only; the shipped weights run on ONNX Runtime.

Start at :mod:`s2r_host.learn.network`; :mod:`s2r_host.learn.train` fits it,
:mod:`s2r_host.perception.affordance` uses it.
"""
