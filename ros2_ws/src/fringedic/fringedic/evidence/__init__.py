"""The log of a run: what its files were when it ended, every later change, and the signature of the laboratory.

The log is ``evidence.log`` in the folder of the run. Each line is an entry in JSON: who, when, why, and the SHA-256 of
every file before and after. It contains the SHA-256 of the line before, so that no earlier line can be changed or
removed. ``evidence.log.sig`` is the Ed25519 signature of the whole log, ``evidence.pem`` the public key.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
