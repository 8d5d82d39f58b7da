# The live node: docker build -f docker/ros.Dockerfile --build-arg DISTRIBUTION=jazzy -t trajeval-ros .
#   docker run --rm --net host trajeval-ros ros2 run trajeval_ros evaluator --ros-args -p ...
# Untried: checked with hadolint, but not built.
ARG DISTRIBUTION=jazzy
FROM ros:${DISTRIBUTION}-ros-base

COPY . /workspace/src/trajeval_ros
WORKDIR /workspace
RUN apt-get update \
    && . "/opt/ros/${ROS_DISTRO}/setup.sh" \
    && rosdep update \
    && rosdep install --from-paths src --ignore-src --yes --dependency-types exec \
    && colcon build \
    && rm -rf /var/lib/apt/lists/*

RUN printf '#!/bin/sh\nset -e\n. /workspace/install/setup.sh\nexec "$@"\n' > /start \
    && chmod +x /start
RUN useradd --create-home trajeval
USER trajeval
ENTRYPOINT ["/start"]
CMD ["ros2", "run", "trajeval_ros", "evaluator", "--help"]
