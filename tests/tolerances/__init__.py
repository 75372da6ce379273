"""Every tolerance of the Python tests, one module an area: value, reason, worst observed."""

import importlib
import pkgutil

for _module in pkgutil.iter_modules(__path__):
    _area = vars(importlib.import_module(f"{__name__}.{_module.name}"))
    globals().update({name: value for name, value in _area.items() if name.isupper()})
