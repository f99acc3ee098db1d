"""The compiled algorithms: loops over time and particles, the same for every model.

The algorithms know models only through the functions of :mod:`pmcl.engine.contract`; one specialised loop is compiled
for each combination of table types. Read in this order: :mod:`~.forward` (the particle filter), with
:mod:`~.weighing` (weights from readings, all at once or one by one) and :mod:`~.resampling`; :mod:`~.backward`
(backward sampling), :mod:`~.densities` (of whole paths) and :mod:`~.smc` (conditional SMC); then :mod:`~.factorisation`
(the Gaussian path of a linearised model) and :mod:`~.linear` (the transport move along it), :mod:`~.metropolis` (the
parameters given a trajectory), :mod:`~.steering` (a simulated robot that follows a path) and :mod:`~.tracking` (the
filter that localizes a robot, without a history). What comes out goes through :mod:`pmcl.filtering` to
:mod:`pmcl.sampling`, localization and the critic.
"""
