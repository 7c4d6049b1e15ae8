"""Physics of a motor: oil, laws of the leakage paths, conditions.

References
----------
The thesis, whose equations are cited by their numbers: N. Ydebäck, *Grey Box Model of Leakage in
Radial Piston Hydraulic Motors*, Luleå University of Technology, 2021.
"""
