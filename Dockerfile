# fynjax on a processor. Not built where it was written:
#   docker build -t fynjax . && docker run --rm -v "$PWD:/plots" fynjax demo
FROM python:3.13-slim
# XML parser of GDAL's wheel.
RUN apt-get update && apt-get install -y --no-install-recommends libexpat1 && rm -rf /var/lib/apt/lists/*
COPY . /source
RUN pip install --no-cache-dir /source && rm -r /source
WORKDIR /plots
ENV XDG_CACHE_HOME=/tmp/cache
ENTRYPOINT ["fynjax"]
CMD ["--help"]
