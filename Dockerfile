# docker build --tag thorvaldc .
# docker run --rm --user "$(id -u):$(id -g)" --volume "$PWD:/robots" thorvaldc check robot.yaml
FROM debian:trixie-slim
# git reads revisions (`diff`); the other libraries are OpenGL without a display, for pictures and videos.
RUN apt-get update && apt-get install --yes --no-install-recommends git libegl1 libegl-mesa0 libgl1-mesa-dri python3-venv && rm -rf /var/lib/apt/lists/*
COPY . /source
RUN python3 -m venv /opt/thorvaldc
RUN /opt/thorvaldc/bin/pip install --no-cache-dir --constraint /source/locks/dev.txt "/source[plot,video]"
# Not root: without --user, the first user of most computers.  A user given with --user has no home folder.
ENV HOME=/tmp
USER 1000:1000
WORKDIR /robots
ENTRYPOINT ["/opt/thorvaldc/bin/thorvaldc"]
