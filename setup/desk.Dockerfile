# A desk: the commands that need no ROS (measure, process, report, export, view, ...) and the library.
#   docker build --file setup/desk.Dockerfile --tag fringedic-desk .
#   docker run --rm --volume "$PWD:/data" fringedic-desk report my_test/bag
# It needs no ROS and reads the recordings of every distribution; --build-arg PYTHON=3.14 selects another Python.
ARG PYTHON=3.12
FROM python:${PYTHON}-slim-bookworm

# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install --yes --no-install-recommends chromium \
    && rm -rf /var/lib/apt/lists/*
COPY ros2_ws/src/fringedic /fringedic/fringedic
# no lock file: the versions have to fit this Python alone, and the packages state what they need
# hadolint ignore=DL3013
RUN pip install --no-cache-dir "/fringedic/fringedic[all]" \
    && python -m fringedic.warm_up
RUN useradd --uid 1000 --create-home measurer && install --directory --owner measurer /data
USER 1000
WORKDIR /data
ENTRYPOINT ["fringedic"]
CMD ["--help"]
