#!/usr/bin/env bash
# Writes all locks anew, with uv: after a change of the dependencies in pyproject.toml, or to move everything forward:
#   requirements/lock.sh [--upgrade]
# Each set but `runtime` holds what it adds to that one. All sets of a machine have the same versions.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
export UV_CUSTOM_COMPILE_COMMAND="requirements/lock.sh"

# lock KIND PYTHON [EXTRA]: the oldest Python of that kind, and what it needs at run time besides
lock() {
  local kind=$1 python=$2 set runtime=(build mavlink "${@:3}") sets=(test lint site colcon)
  local folder=requirements/$kind whole added=()
  whole=$(mktemp)
  resolve() { uv pip compile --quiet --universal --no-annotate --no-emit-index-url --python-version "$python" pyproject.toml "$@" >/dev/null; }
  cat "$folder"/*.lock >"$whole" 2>/dev/null || true  # versions stay where they can
  resolve "${runtime[@]/#/--extra=}" "${sets[@]/#/--extra=}" -c "$folder/limits.in" -o "$whole" "${upgrade[@]}"
  # pymavlink requires lxml to generate dialects, which nothing here does.
  resolve "${runtime[@]/#/--extra=}" -c "$whole" --no-emit-package=lxml --generate-hashes -o "$folder/runtime.lock" --upgrade
  mapfile -t added < <(sed -n 's/^\([A-Za-z0-9._-]*\)==.*/--no-emit-package=\1/p' "$folder/runtime.lock" | sort -u)
  for set in "${sets[@]}"; do
    resolve --extra="$set" -c "$whole" "${added[@]}" --generate-hashes -o "$folder/$set.lock" --upgrade
  done
  rm "$whole"
}

upgrade=("$@")
lock plain 3.10 ros
lock apt 3.12
uv pip compile --quiet --universal --no-annotate --no-emit-index-url --generate-hashes "${upgrade[@]}" \
  --python-version 3.10 - -o requirements/uv.lock <<<uv >/dev/null
