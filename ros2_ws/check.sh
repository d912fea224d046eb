#!/usr/bin/env bash
# Builds the workspace and checks that colcon sees what we mean. Arguments go to `colcon build`:
#   ros2_ws/check.sh --symlink-install
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"

die() { printf 'ros2_ws: error: %s\n' "$*" >&2; exit 1; }
venv=$(cd .. && pwd)/.venv
[ -x "$venv/bin/colcon" ] || die "no colcon in .venv; run: make setup-colcon"
# colcon builds with the python3 it finds first.
export PATH="$venv/bin:$PATH" VIRTUAL_ENV="$venv" COLCON_DEFAULT_EXECUTOR=sequential COLCON_LOG_LEVEL=error
colcon() { "$venv/bin/python" "$venv/bin/colcon" "$@"; }

seen=$(colcon list --base-paths src)
for package in src/*/; do
  name=$(basename "$package")
  # A slip in package.xml (such as an invalid e-mail) silently makes it a plain `python` package.
  grep -qP "^$name\t\S+\t\(ros\.ament_python\)$" <<<"$seen" ||
    die "$name: expected '(ros.ament_python)' from colcon list, which says: $(grep "^$name" <<<"$seen" || echo nothing)"
done

colcon build --base-paths src --event-handlers console_direct- "$@" </dev/null || {
  cat log/latest_build/*/stderr.log >&2
  die "colcon build failed (see above)"
}

checks=()  # beside each other: each is a process that mostly starts
for package in src/*/; do
  name=$(basename "$package")
  [ -e "install/$name/share/ament_index/resource_index/packages/$name" ] || die "$name: not in the ament index"
  [ "$name" != ptnsbc_bringup ] || continue
  # From elsewhere and without the virtual environment's editable install: what ROS would import.
  { (set +u; cd / && source "$OLDPWD/install/local_setup.bash" && python -S -c "
import importlib.util, pathlib
found = importlib.util.find_spec('$name')
assert found and found.origin, '$name: built, but cannot be found'
assert pathlib.Path(found.origin).with_name('py.typed').exists(), '$name: py.typed is missing'
") || die "$name: not importable from install/"; } &
  checks+=($!)
done
for program in ptnsbc_nodes/{uav,sim,recorder,bridge,coordinator} ptnsbc_tools/ptnsbc; do
  program=install/${program%/*}/lib/$program
  [ -x "$program" ] || die "$program: 'ros2 run' would not find it"
  { (set +u; program=$PWD/$program; source install/local_setup.bash; cd / && "$program" --help >/dev/null) || die "$program does not start"; } &
  checks+=($!)
done
for check in "${checks[@]}"; do wait "$check"; done
printf 'ros2_ws: all packages are what they should be, and installed\n'
