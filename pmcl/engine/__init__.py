"""How pmcl compiles: everything that kernels share, and the contract that tables of one's own implement.

Read in this order: :mod:`~.tables` (what a coefficient table is), :mod:`~.contract` (the functions that a table
implements), :mod:`~.compile` (the decorators), :mod:`~.sensor_tuples` and :mod:`~.parameter_draws` (several sensors, many
draws of parameters), :mod:`~.linear_readings` and :mod:`~.residuals` (for the transport move and the Metropolis block).
:mod:`~.functions`, :mod:`~.disk_cache`, :mod:`~.compile_ahead`, :mod:`~.file_lock` and :mod:`~.progress` keep compiled
code; :mod:`~.vector_math`, :mod:`~.random_numbers`, :mod:`~.student` and :mod:`~.views` are small functions for kernels.
"""
