"""Compiles the kernels; run by set-up, commands and nodes."""

from fringedic.warm_up import forget_kernels, mark_compiled
from fringedic.warm_up.pipeline import warm_up

if __name__ == "__main__":
    forget_kernels()
    warm_up()
    mark_compiled()
