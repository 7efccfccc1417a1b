"""A Slurm of one node, started by hand for the tests: its own key, ports and folders, nothing but the loopback.

Needs what Debian calls slurm-wlm and munge. As root or not: the daemons run as whoever starts them.
"""

import contextlib
import getpass
import os
import secrets
import shutil
import signal
import socket
import subprocess
import time
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

PROGRAMS = ("munged", "slurmctld", "slurmd", "sbatch", "srun", "scontrol", "scancel", "squeue", "sinfo", "setpriv")
# Daemons are not on everybody's PATH.
PATH = os.pathsep.join([os.environ.get("PATH", ""), "/usr/sbin", "/usr/local/sbin", "/sbin"])
SOCKET_NAME = 107  # bytes that the name of a socket may have
STARTS_WITHIN = 30  # s
ENDED = ("COMPLETED", "FAILED", "CANCELLED", "TIMEOUT", "NODE_FAIL", "OUT_OF_MEMORY", "BOOT_FAIL", "DEADLINE")

CONFIGURATION = """\
ClusterName=pmpm
# Not 1 again: MPICH names its shared memory after job and step, and does not look whether an old one was left there.
FirstJobId={first_job}
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={ports[0]}
SlurmdPort={ports[1]}
SlurmUser={user}
SlurmdUser={user}
AuthType=auth/munge
# A requeued job begins again no sooner than its old credential has expired; 120 s is the default, 5 s the least.
AuthInfo=socket={folder}/munge.socket,cred_expire=5
CommunicationParameters=NoCtldInAddrAny,NoInAddrAny
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
# Finds a step's processes by descent, those with a session of their own too, as cgroups on a cluster do.
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SwitchType=switch/none
MpiDefault=pmi2
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SchedulerParameters=batch_sched_delay=0,sched_interval=1,sched_min_interval=0,bf_interval=1
PreemptType=preempt/partition_prio
PreemptMode=REQUEUE
MinJobAge=3600
ReturnToService=2
# Whatever this machine has: ranks may share its cores.
SlurmdParameters=config_overrides
NodeName={host} NodeAddr=127.0.0.1 CPUs={cores} State=UNKNOWN
PartitionName=low Nodes={host} Default=YES MaxTime=INFINITE State=UP PriorityTier=1
PartitionName=patient Nodes={host} MaxTime=INFINITE State=UP PriorityTier=1 GraceTime=60
PartitionName=high Nodes={host} MaxTime=INFINITE State=UP PriorityTier=10 PreemptMode=OFF
"""


def missing():
    """The programs that a Slurm of one node needs and this machine has not."""
    return [name for name in PROGRAMS if shutil.which(name, path=PATH) is None]


@dataclass(frozen=True)
class Job:
    """What `scontrol show job` says: state, exit status and signal of the batch script, and how often it was restarted."""

    state: str
    status: int
    signal: int
    restarts: int
    reason: str


class Slurm:
    """A running Slurm; `folder` holds its configuration, logs and state."""

    def __init__(self, folder):
        self.folder = folder
        self.environment = os.environ | {"SLURM_CONF": str(folder / "slurm.conf"), "PATH": PATH}
        # A job of a Slurm around these tests is not ours to speak of.
        for name in [name for name in self.environment if name.startswith(("SLURM_", "SBATCH_", "PMI"))]:
            if name != "SLURM_CONF":
                del self.environment[name]

    def call(self, *command, cwd=None, **environment):
        """Run one of Slurm's commands and return what it printed."""
        done = subprocess.run(
            list(map(str, command)),
            env=self.environment | environment,
            cwd=cwd,
            capture_output=True,
            text=True,
            timeout=60,
        )
        assert done.returncode == 0, f"{command}: {done.returncode}\n{done.stdout}{done.stderr}"
        return done.stdout.strip()

    def submit(self, *arguments, cwd=None, **environment):
        """The number of a new batch job."""
        return int(self.call("sbatch", "--parsable", *arguments, cwd=cwd, **environment).split(";")[0])

    def job(self, number):
        line = self.call("scontrol", "--oneliner", "show", "job", number).splitlines()[0]
        told = dict(word.split("=", 1) for word in line.split() if "=" in word)
        status, _, number = told["ExitCode"].partition(":")
        return Job(told["JobState"], int(status), int(number), int(told["Restarts"]), told["Reason"])

    def wait(self, number, until, limit=60):
        """The job as soon as `until(job)` holds; fails after `limit` seconds, naming the state it is in."""
        began = time.monotonic()
        while not until(job := self.job(number)):
            assert time.monotonic() - began < limit, f"after {limit} s: {job}\n{self.logs()}"
            time.sleep(0.1)
        return job

    def ended(self, number, limit=60):
        """The job once it has ended for good."""
        return self.wait(number, lambda job: job.state in ENDED, limit)

    def logs(self):
        """The last lines of both daemons' logs."""
        paths = (self.folder / "slurmctld.log", self.folder / "slurmd.log")
        return "\n".join(line for path in paths if path.exists() for line in path.read_text().splitlines()[-20:])


@contextmanager
def one_node_slurm(folder, cores):
    """A Slurm below `folder`, ended with everything that runs in it."""
    folder = Path(folder)
    for name in ("state", "spool", "munge"):
        (folder / name).mkdir(parents=True, mode=0o700)
    sock = folder / "munge.socket"
    assert len(os.fsencode(sock)) <= SOCKET_NAME, f"{sock}: too long for the name of a socket"
    key = folder / "munge.key"
    key.write_bytes(secrets.token_bytes(1024))
    key.chmod(0o600)
    (folder / "slurm.conf").write_text(
        CONFIGURATION.format(
            first_job=secrets.randbelow(60_000_000) + 1,
            host=socket.gethostname().split(".")[0],
            ports=free_ports(2),
            user=getpass.getuser(),
            folder=folder,
            cores=cores,
        )
    )
    slurm = Slurm(folder)
    started = []
    try:
        munge = {
            "key-file": key,
            "socket": sock,
            "pid-file": folder / "munged.pid",
            "log-file": folder / "munged.log",
            "seed-file": folder / "munge" / "seed",
        }
        start(
            slurm, started, "munged", "--foreground", "--force", *[f"--{name}={path}" for name, path in munge.items()]
        )
        wait_for(sock.exists, "munged opens its socket", started, slurm)
        start(slurm, started, "slurmctld", "-D")
        start(slurm, started, "slurmd", "-D")
        wait_for(lambda: is_idle(slurm), "the node is idle", started, slurm)
        yield slurm
    finally:
        end_all(slurm, started)


def free_ports(count):
    """Ports of the loopback that nobody listens on now."""
    sockets = [socket.socket() for _ in range(count)]
    for one in sockets:
        one.bind(("127.0.0.1", 0))
    ports = [one.getsockname()[1] for one in sockets]
    for one in sockets:
        one.close()
    return ports


def start(slurm, started, *command):
    """Start a daemon that ends with this process, however this process ends."""
    with open(slurm.folder / f"{command[0]}.out", "wb") as out:
        started.append(
            subprocess.Popen(
                ["setpriv", "--pdeathsig", "KILL", *map(str, command)],
                env=slurm.environment,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        )


def wait_for(claim, what, started, slurm):
    began = time.monotonic()
    while not claim():
        gone = [process.args for process in started if process.poll() is not None]
        outputs = "\n".join(path.read_text() for path in sorted(slurm.folder.glob("*.out")))
        assert not gone, f"{gone} ended\n{outputs}\n{slurm.logs()}"
        assert time.monotonic() - began < STARTS_WITHIN, f"not within {STARTS_WITHIN} s: {what}\n{slurm.logs()}"
        time.sleep(0.1)


def is_idle(slurm):
    return set(ask(slurm, "sinfo", "--noheader", "--format=%T").split()) == {"idle"}


def ask(slurm, *command):
    """What a command prints, whether or not it succeeds."""
    return subprocess.run(command, env=slurm.environment, capture_output=True, text=True, timeout=60).stdout


def end_all(slurm, started):
    """End the jobs, then the daemons in the reverse order, then whatever was left behind by a job."""
    if len(started) == 3 and all(process.poll() is None for process in started):
        with contextlib.suppress(subprocess.TimeoutExpired):
            ask(slurm, "scancel", "--user", getpass.getuser())
            until = time.monotonic() + 5
            while ask(slurm, "squeue", "--noheader") and time.monotonic() < until:
                time.sleep(0.1)
    for process in reversed(started):
        process.terminate()
        try:
            process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
    for pid in processes_of(slurm):
        try:
            os.kill(pid, signal.SIGKILL)
        except ProcessLookupError:
            continue


def processes_of(slurm):
    """Processes that were started within this Slurm: those with its configuration in their environment."""
    mark = f"SLURM_CONF={slurm.environment['SLURM_CONF']}".encode()
    found = []
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit() or int(entry.name) == os.getpid():
            continue
        try:
            if mark in (entry / "environ").read_bytes().split(b"\0"):
                found.append(int(entry.name))
        except OSError:
            continue
    return found
