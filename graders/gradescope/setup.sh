#!/usr/bin/env bash
# Gradescope runs this once, when it builds the container from the ZIP in /autograder/source.
set -e
root=${AUTOGRADER_ROOT:-/autograder}
apt-get update
apt-get install -y python3 python3-venv
python3 -m venv "$root/env"
"$root/env/bin/pip" install "$root/source"
