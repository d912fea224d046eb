#!/usr/bin/env bash
# Makes .venv from the locks that fit this machine: what flying needs, and the sets that are named. The targets of the
# Makefile call it with theirs; where nothing has changed it does nothing.
#   requirements/setup.sh [test] [lint] [site] [colcon] [messages]
#   PYTHON=python3.12 requirements/setup.sh    to choose the interpreter
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

say() { printf 'setup: %s\n' "$*"; }
die() { printf 'setup: error: %s\n' "$*" >&2; exit 1; }

# Two `make` at once must not fill the same folder.
exec 9>.venv.lock
flock 9

fits() { "$1" -c 'import sys; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null; }
has() { "$1" -c "import $2" 2>/dev/null; }

# Running each candidate, not just finding it: version managers put names on PATH that do not start.
choose_python() {
  if [ -n "${PYTHON:-}" ]; then
    fits "$PYTHON" || die "PYTHON=$PYTHON does not run or is not 3.10 to 3.13; choose another: make setup PYTHON=python3.12"
    python=$PYTHON
    return
  fi
  local name without_venv=""
  if [ "${ROS_DISTRO:-}" = jazzy ] && fits python3 && has python3 rclpy; then
    python=python3  # The interpreter that ROS from apt was built for.
    return
  fi
  for name in python3.12 python3.11 python3.13 python3.10 python3; do
    fits "$name" || continue
    if has "$name" "venv, ensurepip"; then
      python=$name
      return
    fi
    without_venv=${without_venv:-$name}
  done
  python=$without_venv
  [ -n "$python" ] || die "no Python 3.10 to 3.13 found ($(python3 --version 2>&1 || true)); install one and run: make setup PYTHON=/path/to/python3.12"
}

need_venv_module() {
  has "$python" "venv, ensurepip" && return
  local package install
  package="python$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')-venv"
  install="apt-get install -y $package"
  if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    say "$python cannot make virtual environments; running: $install"
    { apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$package"; } \
      </dev/null >/dev/null || die "that failed; install $package by hand and repeat: make setup"
  else
    die "$python cannot make virtual environments; run: sudo $install"
  fi
}

choose_python
kind=plain
if [ "${ROS_DISTRO:-}" = jazzy ] && has "$python" rclpy; then
  kind=apt
elif [ -n "${ROS_DISTRO:-}" ]; then
  say "ROS '$ROS_DISTRO' is sourced, but $python cannot import a Jazzy rclpy from it: using the ROS wheels instead"
  unset PYTHONPATH
fi
machine=$("$python" -c 'import platform; print(platform.machine())')
if [ $kind = plain ] && [ "$machine" != x86_64 ]; then
  die "the ROS wheels exist for x86_64 only, this is $machine; install ROS 2 Jazzy from apt (Ubuntu 24.04), source /opt/ros/jazzy/setup.bash and repeat: make setup"
fi

mode="$kind $("$python" -c 'import sys; print(sys.base_prefix, sys.version)' | tr '\n' ' ')"

# A stamp of what a part is made from, and the part when there is no such stamp: part NAME COMMAND FILE...
digest() { { printf '%s' "$mode $PWD"; cat "$@"; } | sha256sum | cut -c1-16; }
parts=()
part() {
  local name=$1 make=$2 stamp began=$SECONDS
  shift 2
  stamp=".venv/.$name-$(digest "$@")"
  [ ! -e "$stamp" ] || return 0
  "$make" "$name" || return 0
  rm -f .venv/."$name"-*
  touch "$stamp"
  parts+=("$name $((SECONDS - began)) s")
}

make_venv() {
  local site=()
  need_venv_module
  say "$("$python" --version), requirements/$kind -> .venv"
  [ $kind = plain ] || site=(--system-site-packages)
  "$python" -m venv --clear "${site[@]}" .venv || die "could not make .venv with $python"
  printf '%s' "$mode" >.venv/.mode
}

# --no-deps: a lock is complete, there is nothing to resolve. Every file must have a hash of the lock.
pip=(.venv/bin/python -m pip --quiet --disable-pip-version-check --no-input install --progress-bar off --no-deps)
# uv installs a lock in a fifth of pip's time: the user's, or one that is kept only while this runs. Without it pip does all.
find_uv() {
  uv=$(command -v uv) && return
  tools=$(mktemp -d)
  trap 'rm -rf "$tools"' EXIT
  "${pip[@]}" --target "$tools" --require-hashes -r requirements/uv.lock 2>/dev/null || true
  uv=$tools/bin/uv
}

install() {
  [ -n "${uv:-}" ] || find_uv
  export UV_SYSTEM_CERTS="${UV_SYSTEM_CERTS:-1}" UV_NATIVE_TLS="${UV_NATIVE_TLS:-1}"  # the computer's certificates, as pip's
  if [ -x "$uv" ]; then
    "$uv" pip install --quiet --no-progress --python .venv/bin/python --no-deps "$@" && return
    say "uv could not; trying pip"
  fi
  "${pip[@]}" "$@"
}

make_set() {
  local lock=requirements/$kind/$1.lock
  install --require-hashes -r "$lock" || die "$lock could not be installed (see above); repeat with: make setup"
}

# The tests of the large packages take 30 MB, which nobody here runs. The wheels of ROS hold the same libraries up to
# eight times: 70 MB that equal files share.
make_runtime() {
  make_set runtime
  find .venv/lib/python*/site-packages/{matplotlib,numba,numpy,scipy} -type d -name tests -prune \
    -exec rm -r {} + 2>/dev/null || true
  ! command -v hardlink >/dev/null || hardlink --quiet --ignore-time .venv || true
}

make_project() {
  install --no-build-isolation -e . || die "this project could not be installed (see above)"
  .venv/bin/python -c '
import numba, numpy, rclpy
print(f"setup: numpy {numpy.__version__}, numba {numba.__version__}, rclpy from {rclpy.__path__[0]}")' \
    || die "the packages are installed but do not load (see above); start afresh: make clean setup"
}

# Messages that the wheels lack, and those of tests. Without them everything flies, but nothing draws frames live.
make_messages() {
  if ! command -v g++ >/dev/null; then
    say "no g++: there is no live /tf (bags have it); install g++ and repeat: make setup-messages"
  elif ! .venv/bin/python requirements/interfaces/build.py "${messages[@]%/}"; then
    say "the message packages above could not be built: no live /tf (bags have it)"
  else
    return 0
  fi
  return 1
}

if [ "$(cat .venv/.mode 2>/dev/null)" != "$mode" ] || ! .venv/bin/python -c '' 2>/dev/null; then
  make_venv
  parts+=("environment $SECONDS s")
fi
part runtime make_runtime "requirements/$kind/runtime.lock"
part project make_project pyproject.toml setup.py ros2_ws/shell.py
# The messages are compiled while the packages of the other sets come.
compiling=
if [ $kind = plain ] && [[ " $* " == *" messages "* ]]; then
  (
    parts=()
    for built in messages test-messages; do
      case $built in
        messages) messages=(requirements/interfaces/*/package.xml) ;;
        *) [[ " $* " == *" test "* ]] || continue; messages=(tests/messages/*/package.xml) ;;
      esac
      messages=("${messages[@]%package.xml}")
      mapfile -t sources < <(find requirements/plain/runtime.lock requirements/interfaces/build.py "${messages[@]}" -type f | sort -u)
      part $built make_messages "${sources[@]}"
    done
    [ ${#parts[@]} = 0 ] || say "${parts[*]}"
  ) &
  compiling=$!
fi
for set in "$@"; do
  [ "$set" != messages ] || continue
  lock=requirements/$kind/$set.lock
  [ -e "$lock" ] || die "no $lock; the sets are messages, $(basename -s .lock requirements/$kind/*.lock | paste -sd, | sed 's/,/, /g')"
  part "$set" make_set "$lock"
done
[ -z "$compiling" ] || wait "$compiling"
[ ${#parts[@]} = 0 ] || say "done in $SECONDS s ($(IFS=,; echo "${parts[*]}" | sed 's/,/, /g')); .venv has $(du -sm .venv | cut -f1) MB"
