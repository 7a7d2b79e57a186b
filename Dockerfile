# docker build -t ovmot . && docker run --rm -v "$PWD/runs:/runs" ovmot demo /runs/demo
FROM python:3.12-slim AS build
RUN pip install --no-cache-dir build && apt-get update && apt-get install -y --no-install-recommends git
WORKDIR /src
COPY . .
RUN python -m build --wheel --outdir /dist

FROM python:3.12-slim
COPY --from=build /dist /dist
RUN pip install --no-cache-dir /dist/*.whl && rm -r /dist \
    && useradd --create-home ovmot && mkdir /runs && chown ovmot /runs
USER ovmot
# for the processor that builds the image; another one compiles at its first run
RUN ovmot warmup
WORKDIR /runs
ENTRYPOINT ["ovmot"]
