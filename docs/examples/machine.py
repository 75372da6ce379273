"""Sets the number of threads, and reports the instruction set in use."""

import gsut

gsut.set_num_threads(2)
print(gsut.num_threads(), gsut.machine.active_isa(), gsut.machine.available_isas())
gsut.set_num_threads(0)  # all processors
