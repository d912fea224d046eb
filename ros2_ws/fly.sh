#!/usr/bin/env bash
# From a clean copy of this checkout: colcon builds it, plain over what an older version left and with
# --symlink-install; pip installs the same, twice. Then the executables of the plain build fly 6 s of paper_5, from
# another folder and without the sources. Needs .venv (make setup-colcon). What is installed there of this project is
# not seen: everything runs in environments like it that have the project from one place only.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

say() { printf 'ros2_ws: [%3d s] %s\n' "$SECONDS" "$*"; }
die() { printf 'ros2_ws: error: %s\n' "$*" >&2; exit 1; }
[ -x .venv/bin/colcon ] || die "no colcon in .venv; run: make setup-colcon"

mkdir -p out
scratch=$(mktemp -d "$PWD/out/colcon-XXXXXX")  # on the disk of .venv, whose files it shares by hard links
trap 'rm -rf "$scratch"' EXIT
unset PYTHONPATH
export PIP_DISABLE_PIP_VERSION_CHECK=1
version=$(sed -n 's/^version = "\(.*\)"$/\1/p' pyproject.toml)

# Without what lies about in this checkout: build/, *.egg-info, ros2_ws/install.
copy() {
  mkdir -p "$scratch/$1"
  git ls-files -z --cached --others --exclude-standard | while IFS= read -rd '' name; do
    if [ -e "$name" ]; then printf '%s\0' "$name"; fi
  done | xargs -0 cp -a --parents -t "$scratch/$1"
}

bare() {
  mkdir "$scratch/$1"
  cp -al .venv/. "$scratch/$1"
  (cd "$scratch/$1" && rm -rf bin/ptnsbc lib/{,lib}ptnsbc_* share/ptnsbc* share/ament_index/resource_index/*/ptnsbc_* \
    lib/python*/site-packages/{ptnsbc-*,ptnsbc_*,__editable__*ptnsbc*,__editable___ptnsbc*,__pycache__/__editable___ptnsbc*})
}

# In a workspace that was built, from another folder: what a shell with its setup.bash would do.
within() {
  (set +u && cd / && source "$scratch/$1/ros2_ws/install/local_setup.bash" && PATH="$scratch/env/bin:$PATH" && "${@:2}")
}

# Where every module of ours is found, each below a folder: places FOLDER PYTHON
places() {
  "$2" - "$(realpath "$1")" <<'PYTHON'
import importlib.util, pkgutil, sys
for name in ("ptnsbc_core", "ptnsbc_io", "ptnsbc_sim", "ptnsbc_autopilot", "ptnsbc_nodes", "ptnsbc_tools", "ptnsbc"):
    package = importlib.import_module(name)
    for module in pkgutil.walk_packages(package.__path__, f"{name}."):
        place = importlib.util.find_spec(module.name).origin
        assert place.startswith(f"{sys.argv[1]}/"), f"{module.name} is {place}: expected it below {sys.argv[1]}"
        assert "ghost" not in module.name, f"{place} was left by another version"
PYTHON
}

check_version() {
  local said
  said=$("${@:2}" --version)
  [ "$said" = "ptnsbc $version" ] || die "$1: ptnsbc --version says '$said': expected 'ptnsbc $version'"
}

# What `ros2 run` finds, and what is on the path; every one of them tells the version when run as told.
#   check_programs WHAT, where ptnsbc_nodes and ptnsbc_tools are, COMMAND...
names=
check_programs() {
  local what=$1 nodes=$2 tools=$3 found program checks=()
  shift 3
  found=$(cd "$nodes/lib" && ls ptnsbc_nodes/*; cd "$tools/lib" && ls ptnsbc_tools/*; cd "$tools" && ls bin/ptnsbc*)
  [ "$found" = "${names:=$found}" ] || die "$what: programs: ${found//$'\n'/ }: expected as colcon made them: ${names//$'\n'/ }"
  for program in "$nodes"/lib/ptnsbc_nodes/* "$tools/lib/ptnsbc_tools/ptnsbc" "$tools/bin/ptnsbc"; do
    check_version "$what: $program" "$@" "$program" &
    checks+=($!)
  done
  for program in "${checks[@]}"; do wait "$program"; done
}

# A module that is no more, as an older version leaves it where builds put things.
haunt() {
  mkdir -p "$1"
  touch "$1/ghost.py"
}

build() {
  ln -sfn ../env "$scratch/$1/.venv"
  "$scratch/$1/ros2_ws/check.sh" "${@:2}"
}

# One process per vehicle, as ros2 run and launch start them; the leader starts when nobody waits any more.
fly() {
  local programs=$scratch/plain/ros2_ws/install/ptnsbc_nodes/lib/ptnsbc_nodes uav pids=()
  local common=(--scenario "$scratch/flight.yaml" --lockstep)
  "$programs/recorder" --bag "$scratch/bag" --uavs 1 2 3 4 5 --lockstep --attach "scenario.yaml=$scratch/flight.yaml" &
  pids+=($!)
  for uav in 1 2 3 4 5; do
    "$programs/uav" "${common[@]}" --recorded --uav "$uav" &
    pids+=($!)
  done
  "$programs/sim" "${common[@]}" --recorded &
  local sim=$!
  "$programs/coordinator" --scenario "$scratch/flight.yaml" --patience 300 || { kill "${pids[@]}" "$sim"; return 1; }
  wait "$sim"
  kill -INT "${pids[@]}"
  wait "${pids[@]}"
}

say "colcon build, over what an older version left"
bare env
copy plain
haunt "$scratch/plain/ros2_ws/build/ptnsbc_nodes/build/lib/ptnsbc_nodes"
build plain
[ ! -e "$scratch/env/bin/ptnsbc" ] || die "the environment is not bare"
installed=$scratch/plain/ros2_ws/install
check_programs "colcon build" "$installed"/ptnsbc_{nodes,tools} within plain

say "colcon build --symlink-install"
copy linked
build linked --symlink-install
check_programs "colcon build --symlink-install" "$scratch"/linked/ros2_ws/install/ptnsbc_{nodes,tools} within linked
within linked places "$scratch/linked" python

say "pip install ., over what older versions left"
copy wheel
haunt "$scratch/wheel/build/lib/ptnsbc_nodes"
mkdir "$scratch/wheel/ptnsbc.egg-info"
printf 'Metadata-Version: 2.1\nName: ptnsbc\nVersion: 0.0.1\n' >"$scratch/wheel/ptnsbc.egg-info/PKG-INFO"
pip=("$scratch/env/bin/python" -m pip --quiet --no-input install --no-deps --no-build-isolation --no-index)
"${pip[@]}" "$scratch/wheel"
check_programs "pip install" "$scratch"/env{,} env -C /
(cd / && places "$scratch/env" "$scratch/env/bin/python")
check_version "pip install, in another checkout" env -C "$scratch/linked" "$scratch/env/bin/ptnsbc"

say "pip install -e ., over that"
"${pip[@]}" -e "$scratch/linked"
check_programs "pip install -e" "$scratch"/env{,} env -C /
(cd / && places "$scratch/linked" "$scratch/env/bin/python")

say "the workspace again, with an older version installed by pip"
check_programs "colcon build, pip beside" "$scratch"/linked/ros2_ws/install/ptnsbc_{nodes,tools} within linked

say "pip uninstall"
"$scratch/env/bin/python" -m pip --quiet uninstall --yes ptnsbc
left=$(cd "$scratch/env" && find . -path '*ptnsbc*' -not -type d -not -path '*/__pycache__/*')
[ -z "$left" ] || die "pip uninstall left ${left//$'\n'/ }"

say "a flight of 6 s with the installed executables, the sources gone"
rm -rf "$scratch"/plain/ptnsbc_* "$scratch"/plain/ros2_ws/{src,build}
within plain places "$installed" python
within plain "$installed/ptnsbc_tools/bin/ptnsbc" check paper_5 >/dev/null
sed 's/^  duration_s: .*/  duration_s: 6/' scenarios/paper_5.yaml >"$scratch/flight.yaml"
within plain python -c "
from ptnsbc_nodes.runtime.warmup import load_agent, load_world
from ptnsbc_sim.scenario import load_scenario
scenario = load_scenario('$scratch/flight.yaml')
load_agent(scenario, 1)
load_world(scenario)"
export ROS_DOMAIN_ID=${ROS_DOMAIN_ID:-$((RANDOM % 100 + 1))}
within plain fly
within plain ptnsbc verify "$scratch/bag"

say "all of it from where it was meant to be"
