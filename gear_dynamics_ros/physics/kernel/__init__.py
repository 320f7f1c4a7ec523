"""The compiled model and its integrator: chapters to be read beside docs/model.md.

``records``   record types that are passed around
``columns``   columns and codes of what is written
``sources``   the hash of this folder
``compiling`` how functions are compiled and cached
``lanes``     vectors of both gears, or of eight waves
``series``    elementary functions as polynomials
``waves``     periodic excitations: surfaces, stiffness, static error
``film``      oil film
``bearing``   bearing contact
``mesh``      teeth in mesh
``dynamics``  equations of motion, load and governor
``events``    switching surfaces
``impulse``   what RK4 misses of the mesh force
``step``      one trial step with frozen flags
``search``    where in a step an event falls
``switches``  what an event switches
``substeps``  one whole step, split at its events
``output``    samples and energies
``entry``     what Python calls

Symbols and equation numbers are the paper's; all values are SI. A hot function returns a status and never
raises. Nothing here depends on the rest of the package but ``columns`` on its channel table.
"""
