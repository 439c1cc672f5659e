# The PC of a rig: all nodes with ROS 2, drivers of real cameras, and the command.
#   docker build --file setup/rig.Dockerfile --tag fringedic-rig .                             # Jazzy from PyPI
#   docker build --file setup/rig.Dockerfile --tag fringedic-rig --build-arg ROS=kilted .      # Kilted from PyPI
#   docker build --file setup/rig.Dockerfile --tag fringedic-rig --build-arg ROS=lyrical \
#       --build-arg BASE=ros:lyrical-ros-base --build-arg HARDWARE=no .                        # an image with ROS 2
#   docker run --rm --shm-size 512m --network host --device /dev/video0 --volume "$PWD:/data" fringedic-rig run RIG.yaml
ARG BASE=debian:bookworm-slim
# hadolint ignore=DL3006
FROM ${BASE}
ARG ROS=jazzy
# Aravis, displays and printing need packages of Debian, which images of ROS 2 (Ubuntu) partly do not have
ARG HARDWARE=yes

SHELL ["/bin/bash", "-o", "pipefail", "-c"]
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install --yes --no-install-recommends g++ git make python3-dev python3-venv \
    && rm -rf /var/lib/apt/lists/*
# images of Ubuntu have a user of this number
RUN (userdel --remove ubuntu 2>/dev/null || true) \
    && useradd --uid 1000 --create-home --groups video measurer \
    && install --directory --owner measurer /fringedic /data
USER 1000
COPY --chown=measurer . /fringedic
WORKDIR /fringedic
# hadolint ignore=SC1090
RUN if [ -f "/opt/ros/$ROS/setup.bash" ]; then . "/opt/ros/$ROS/setup.bash"; fi && make setup

# system packages of cameras, displays and printing; the bindings are compiled for the environment above
USER 0
RUN if [ "$HARDWARE" = yes ]; then setup/hardware.sh --install && rm -rf /var/lib/apt/lists/* && chown -R measurer .venv; fi
USER 1000
WORKDIR /data
ENV FRINGEDIC_ROS=$ROS
ENTRYPOINT ["/bin/bash", "-c", "if [ -f \"/opt/ros/$FRINGEDIC_ROS/setup.bash\" ]; then . \"/opt/ros/$FRINGEDIC_ROS/setup.bash\"; fi; exec /fringedic/.venv/bin/fringedic \"$@\"", "fringedic"]
CMD ["--help"]
