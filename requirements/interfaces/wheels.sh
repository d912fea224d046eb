#!/usr/bin/env bash
# Wheels of the message packages in dist/, for every Python from 3.10 to 3.13 on this machine. Called by `make wheels`.
#   requirements/interfaces/wheels.sh [PACKAGE...]    by default those beside this script
#   PYTHON="python3.10 /opt/python/bin/python3.12" requirements/interfaces/wheels.sh    to name the interpreters
# Each is built in an environment of its own from plain/runtime.lock, which takes a minute, and is installed and
# imported there before it counts.
set -euo pipefail
packages=()
for folder in "$@"; do packages+=("$(realpath "$folder")"); done
cd "$(dirname "${BASH_SOURCE[0]}")/../.."
[ $# -gt 0 ] || packages=("$PWD"/requirements/interfaces/*/package.xml)
packages=("${packages[@]%/package.xml}")

say() { printf 'wheels: %s\n' "$*"; }
version() { "$1" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null; }

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
missing=() made=()

# One interpreter: an environment, the wheels, and an import of what they hold.
build_for() {
  local python=$1 venv=$work/venv out=$work/out pip
  rm -rf "$venv" "$out"
  "$python" -m venv "$venv"
  pip=("$venv/bin/python" -m pip --quiet --disable-pip-version-check --no-input)
  "${pip[@]}" install --progress-bar off --no-deps --require-hashes -r requirements/plain/runtime.lock
  "$venv/bin/python" requirements/interfaces/build.py --wheels "$out" "${packages[@]}"
  "${pip[@]}" install --no-deps --no-index "$out"/*.whl
  for package in "${packages[@]}"; do
    # An import alone loads no library: the support of each type does.
    "$venv/bin/python" -c '
import importlib.util, sys
import rclpy
kinds = [k for k in ("msg", "srv", "action") if importlib.util.find_spec(f"{sys.argv[1]}.{k}")]
modules = [importlib.import_module(f"{sys.argv[1]}.{k}") for k in kinds]
types = [getattr(module, name) for module in modules for name in dir(module) if name[0].isupper()]
assert types, "no types"
for one in types:
    if isinstance(one, type):
        one.__class__.__import_type_support__()
        assert one.__class__._TYPE_SUPPORT is not None, one' "$(basename "$package")"
  done
  mkdir -p dist
  mv "$out"/*.whl dist/
}

if [ -n "${PYTHON:-}" ]; then
  read -ra pythons <<<"$PYTHON"
else
  pythons=(python3.10 python3.11 python3.12 python3.13)
fi
for python in "${pythons[@]}"; do
  if ! found=$(version "$python"); then
    missing+=("$python")
    continue
  fi
  case $found in
    3.10 | 3.11 | 3.12 | 3.13) ;;
    *) say "error: $python is Python $found: expected 3.10 to 3.13" >&2; exit 1 ;;
  esac
  say "Python $found ..."
  build_for "$python"
  made+=("$found")
done
if [ ${#made[@]} = 0 ]; then
  say "error: ${missing[*]} do not run here: name the interpreters, make wheels PYTHON=\"/path/to/python3.12 ...\"" >&2
  exit 1
fi
ls dist/*.whl
if [ ${#missing[@]} -gt 0 ]; then
  say "no wheels of ${missing[*]}, which do not run here: name the interpreters, make wheels PYTHON=\"/path/to/python3.12 ...\""
fi
