#!/usr/bin/env bash
# CI mode B: snapshots, restarts and faults with a real MPI-built h5py, so that driver="mpio" is run and not only written.
#
#   .ci/parallel_hdf5.sh VENV        VENV: a folder for the virtual environment (made anew if it is not there)
#
# PyPI has no h5py wheel with MPI. Debian packages one (python3-h5py-mpi, built against Open MPI): no compiler and under a
# minute, where building h5py from source takes about four. It is also the oldest h5py and numpy that pmpm claims to support.
set -euo pipefail

venv=${1:?usage: .ci/parallel_hdf5.sh VENV}
cd "$(dirname "$0")/.."
began=$SECONDS

packages=(python3-h5py-mpi python3-mpi4py python3-numpy python3-venv openmpi-bin)
if ! dpkg-query -W -f '${Status}\n' "${packages[@]}" 2>/dev/null | grep -c '^install ok installed' | grep -qx "${#packages[@]}"; then
    export DEBIAN_FRONTEND=noninteractive
    apt-get update -qq
    apt-get install -y -qq --no-install-recommends "${packages[@]}" >/dev/null
fi

# The environment sees Debian's packages; numpy is held at Debian's version, for its h5py dies under a newer one
# ("numpy.dtype size changed"), and pip must not be asked for h5py: it would put its serial wheel before Debian's. Nor may an
# MPI wheel enter: mpi4py would load it instead of the Open MPI that h5py uses.
if [ ! -x "$venv/bin/python" ]; then
    /usr/bin/python3 -m venv --system-site-packages "$venv"
fi
numpy=$(/usr/bin/python3 -c 'import numpy; print(numpy.__version__)')
mapfile -t needed < <(/usr/bin/python3 -c '
import tomllib
wanted = tomllib.load(open("pyproject.toml", "rb"))["project"]["dependencies"]
print(*(line for line in wanted if not line.startswith("h5py")), sep="\n")')
"$venv/bin/python" -m pip install -q --disable-pip-version-check \
    "numpy==$numpy" "${needed[@]}" 'pytest>=9' 'pytest-timeout>=2.4' 'pytest-mpi>=0.6'
echo "parallel HDF5: environment ready after $((SECONDS - began)) s"

# Open MPI refuses root and more ranks than cores unless told.
export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1
export PYTHONPATH=$PWD OMP_NUM_THREADS=1
mpirun=(/usr/bin/mpirun.openmpi --bind-to none --oversubscribe)

# Asserted inside mpirun: Debian's h5py is parallel only there, and without MPI every test below would be skipped unseen.
"${mpirun[@]}" -n 2 "$venv/bin/python" -c '
import h5py, mpi4py, numpy
from mpi4py import MPI
assert MPI.COMM_WORLD.size == 2, f"a world of {MPI.COMM_WORLD.size}, not 2"
assert h5py.get_config().mpi, f"h5py from {h5py.__file__} has no MPI"
if MPI.COMM_WORLD.rank == 0:
    print("parallel HDF5: h5py", h5py.__version__, "HDF5", h5py.version.hdf5_version, "numpy", numpy.__version__,
          "mpi4py", mpi4py.__version__, MPI.get_vendor())'

# Every rank runs pytest; the closing lines of the others would interleave with rank 0's.
for ranks in 2 3; do
    "${mpirun[@]}" -n "$ranks" bash -c '
        [ "$OMPI_COMM_WORLD_RANK" = 0 ] || exec >/dev/null
        exec "$0" -m pytest --with-mpi -q -rs --color=no --timeout=120 --timeout-method=thread tests/mpi/test_snapshots_mpi.py \
            tests/mpi/test_restart_mpi.py' \
        "$venv/bin/python"
done

# A full disk, a folder that vanishes, a damaged checkpoint and a rank that is killed, with files written by MPI-IO.
PMPM_TEST_MPIRUN=${mpirun[*]} "$venv/bin/python" -m pytest -q -rs --color=no --timeout=200 --timeout-method=thread \
    tests/test_faults.py tests/test_kills.py -k '(grow and 2) or full or vanishes or (falls and flipped) or (outside and rank)'
echo "parallel HDF5: done after $((SECONDS - began)) s"
