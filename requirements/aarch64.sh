#!/bin/bash
# Whether a lock can be installed on a companion computer: every package of apt/runtime.lock (or of the lock that is given)
# has a wheel for aarch64 and CPython 3.12 whose hash is in the lock, or is pure Python. empy alone has no wheel; its
# source is pure Python. Nothing is installed. Without a registry that answers nothing is asked, and that is said.
set -euo pipefail
cd "$(dirname "$0")/.."
lock=${1:-requirements/apt/runtime.lock}
if ! .venv/bin/python -m pip index versions empy >/dev/null 2>&1; then
  echo "$lock: not checked: no package registry answers"
  exit 0
fi
tags=()
for tag in manylinux2014 manylinux_2_17 manylinux_2_24 manylinux_2_26 manylinux_2_27 manylinux_2_28 manylinux_2_31 manylinux_2_34 manylinux_2_35 manylinux_2_39; do
  tags+=(--platform "${tag}_aarch64")
done
.venv/bin/python -m pip install --quiet --dry-run --ignore-installed --no-deps --require-hashes --only-binary=:all: --no-binary=empy \
  --implementation cp --python-version 3.12 "${tags[@]}" --target /nonexistent -r "$lock"
echo "$lock: $(grep -c '==' "$lock") packages, each with a wheel for aarch64"
