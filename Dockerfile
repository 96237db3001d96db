# Rendering, browsing and training in a container.
#
#   docker build --tag totalediting .                          # for CPUs
#   docker build --tag totalediting --build-arg DEVICE=gpu .   # for NVIDIA's GPUs
#   docker run --rm --user "$(id -u)" --volume "$PWD/out:/data" totalediting \
#     synthgen render demo --out /data/demo
#
# With DEVICE=gpu, add `--gpus all` to the second and `--device optix` to what it runs.
FROM python:3.11-slim-bookworm

# What Blender's wheel links to.
RUN apt-get update \
 && apt-get install --yes --no-install-recommends \
      libx11-6 libxrender1 libxfixes3 libxi6 libxkbcommon0 libsm6 libgl1 \
 && rm -rf /var/lib/apt/lists/*

# The CPU build of torch is a tenth of the size. Before the sources, so that it is installed once.
ARG DEVICE=cpu
RUN case "$DEVICE" in \
      cpu) pip install --no-cache-dir --extra-index-url https://download.pytorch.org/whl/cpu \
             torch==2.13.0+cpu ;; \
      gpu) pip install --no-cache-dir torch==2.13.0 ;; \
      *) echo "DEVICE=$DEVICE: choose cpu or gpu" >&2; exit 2 ;; \
    esac

COPY pyproject.toml MANIFEST.in README.md LICENSE /source/
COPY assets_procedural /source/assets_procedural
COPY render_jobs /source/render_jobs
COPY synthgen /source/synthgen
COPY totalediting /source/totalediting
RUN pip install --no-cache-dir '/source[render,browse,train]' && rm -r /source

# Libraries of the driver that NVIDIA's container runtime is to bring: for torch, and for OptiX.
ENV NVIDIA_VISIBLE_DEVICES=all \
    NVIDIA_DRIVER_CAPABILITIES=compute,graphics,utility \
    SYNTHGEN_CACHE=/tmp/cache
WORKDIR /data
CMD ["synthgen", "--help"]
