"""A plugin of pytest (-p instrumented_core): the core that GSUT_CORE names, compiled with a
sanitizer, in place of the installed one."""

import importlib.util
import os
import sys

_spec = importlib.util.spec_from_file_location("gsut._core", os.environ["GSUT_CORE"])
assert _spec is not None and _spec.loader is not None
sys.modules["gsut._core"] = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(sys.modules["gsut._core"])
