# docker build --tag thorvaldc .
# docker run --rm --volume "$PWD:/robots" thorvaldc check robot.yaml
FROM debian:trixie-slim
RUN apt-get update && apt-get install --yes --no-install-recommends python3-venv && rm -rf /var/lib/apt/lists/*
COPY . /source
RUN python3 -m venv /opt/thorvaldc
RUN /opt/thorvaldc/bin/pip install --no-cache-dir --constraint /source/locks/dev.txt "/source[plot]"
WORKDIR /robots
ENTRYPOINT ["/opt/thorvaldc/bin/thorvaldc"]
