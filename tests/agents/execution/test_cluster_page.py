"""What docs/howto/cluster.md says of clusters: Ray's YAML, the Slurm script, submitit's jobs."""

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import cloudpickle
import pytest
import unit_calls
from unit_calls import dies, noted, runs

from agents.cli.commands import parse
from agents.execution.encoding import decoded
from agents.execution.options import ExecutionOptions
from agents.execution.submitit_executor import SubmititExecutor
from agents.execution.units import Unit, UnitRunner
from agents.execution.worker import Call

cloudpickle.register_pickle_by_value(unit_calls)  # jobs do not have this folder

PAGE = (Path(__file__).parents[3] / "docs/howto/cluster.md").read_text(encoding="utf-8")
BASH = "#!/bin/bash\n"


def shell_blocks():
    return re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)


def cluster_yaml():
    yaml = pytest.importorskip("yaml", reason="PyYAML is not installed: MkDocs and Ray bring it")
    (text,) = re.findall(r'```yaml title="cluster.yaml"\n(.*?)```', PAGE, re.DOTALL)
    return yaml.safe_load(text)


def test_the_ray_cluster_is_one_by_rays_own_schema():
    autoscaler = pytest.importorskip("ray.autoscaler", reason="ray is not installed: it is an extra")
    jsonschema = pytest.importorskip("jsonschema", reason="jsonschema is not installed: it is in dev")
    from ray.autoscaler._private.util import prepare_config, validate_config

    schema = json.loads((Path(autoscaler.__file__).parent / "ray-schema.json").read_text())
    jsonschema.validate(cluster_yaml(), schema)
    prepared = prepare_config(cluster_yaml())
    validate_config(prepared)
    assert prepared["available_node_types"]["local.cluster.node"]["min_workers"] == 2


def test_the_head_of_the_ray_cluster_starts_its_workers():
    """Without this option it starts none, as `ray up` warns."""
    (start,) = (line for line in cluster_yaml()["head_start_ray_commands"] if "--head" in line)
    assert "--autoscaling-config=~/ray_bootstrap_config.yaml" in start


def test_the_shell_of_the_page_is_shell():
    for block in shell_blocks():
        checked = subprocess.run(["bash", "-n"], input=block, text=True, capture_output=True)
        assert checked.returncode == 0, (block, checked.stderr)


def test_a_command_within_another_is_understood_too():
    (inner,) = re.findall(r'^ray exec cluster.yaml "(.*)"$', PAGE, re.MULTILINE)
    words = shlex.split(inner.partition("-m agents ")[2])
    assert parse(words).execution.ray_address == "auto"


@pytest.fixture
def program(tmp_path, monkeypatch):
    """Make a program of Bash in a folder that comes first on the path."""
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", f"{folder}:{os.environ['PATH']}")

    def make(name, text, at=folder):
        at.mkdir(parents=True, exist_ok=True)
        (at / name).write_text(BASH + text)
        (at / name).chmod(0o755)

    return make


def test_the_slurm_script_starts_a_cluster_runs_the_command_and_ends_it(program, tmp_path):
    (script,) = (block for block in shell_blocks() if block.startswith(BASH))
    shared, calls = tmp_path / "shared", tmp_path / "calls"
    program("ray", f'echo "ray $*" >> {calls}\n', at=shared / ".venv/bin")
    # It begins when the other nodes have joined, and ends badly.
    joined = f"until (($(grep -c '^ray.*block' {calls}) >= 2)) || ((++n > 300)); do sleep 0.1; done\n"
    program("shake", f'{joined}echo "shake $*" >> {calls}\nexit 3\n', at=shared / ".venv/bin")
    program(
        "srun",
        f'echo "srun $*" >> {calls}\nwhile [[ $1 == --* ]]; do shift; done\n'
        'for ((i = 1; i < SLURM_NNODES; i++)); do "$@"; done\n',
    )
    given = {"SLURMD_NODENAME": "node1", "SLURM_NNODES": "3", "SLURM_CPUS_PER_TASK": "4"}
    done = subprocess.run(
        ["bash", "-eu"],
        input=script.replace("/shared/shake", str(shared)),
        text=True,
        capture_output=True,
        env={**os.environ, **given},
    )
    assert done.returncode == 3, done.stderr  # the command's
    lines = calls.read_text().splitlines()
    assert lines[:2] == [
        "ray get-auth-token --generate",
        "ray start --head --port=6379 --num-cpus=4",
    ]
    assert lines[2].startswith("srun --nodes=2 --ntasks=2 --cpus-per-task=4 --exclude=node1 ")
    assert lines[3:5] == ["ray start --address=node1:6379 --num-cpus=4 --block"] * 2
    command = parse(shlex.split(lines[5])[1:])
    assert command.execution.ray_address == "node1:6379" and command.execution.worker_memory == 2.5
    assert lines[6:] == ["ray stop"]


@pytest.fixture
def slurm(program, tmp_path):
    """Programs in place of Slurm's: a job is a process group of this machine. Returns their folder."""
    state = tmp_path / "slurm"
    state.mkdir()
    job = "SLURM_JOB_ID=$id SLURM_NTASKS=1 SLURM_JOB_NUM_NODES=1 SLURM_JOB_NODELIST=node1"
    program(
        "sbatch",
        f"cd {state}; id=$((100 + $(ls | grep -c sh$)))\n"
        f'cp "$1" $id.sh; {job} setsid bash $id.sh > $id.out 2>&1 < /dev/null &\n'
        "echo $! > $id.pid; echo Submitted batch job $id\n",
    )
    program(
        "srun",
        "while [[ $1 == --* ]]; do case $1 in --output) out=$2; shift ;;\n"
        "--error) err=$2; shift ;; esac\n"
        "shift; done\n"
        'fill() { f=${1//%j/$SLURM_JOB_ID}; echo "${f//%t/0}"; }\n'
        'exec "$@" > "$(fill "$out")" 2> "$(fill "$err")"\n',
    )
    program(
        "sacct",
        "echo 'JobID|State|NodeList'\nwhile (($#)); do if [[ $1 == -j ]]; then\n"
        f'kill -0 $(cat {state}/$2.pid) 2> /dev/null && s=RUNNING || s=FAILED; echo "$2|$s|node1"\n'
        "fi; shift; done\n",
    )
    program("scancel", f"echo $1 >> {state}/cancelled; kill -KILL -- -$(cat {state}/$1.pid)\n")
    return state


@pytest.mark.slow
def test_jobs_of_submitit_go_through_slurms_programs(slurm, tmp_path):
    pytest.importorskip("submitit", reason="submitit is not installed: it is an extra")
    folder = str(tmp_path)
    options = ExecutionOptions(
        executor="submitit",
        processes=2,
        units=tmp_path / "units",
        worker_memory=1.5,
        slurm=("slurm_partition=cpu", "timeout_min=7"),
    )
    units = [Unit(f"unit{i}", noted, (folder, f"unit{i}", i)) for i in range(5)]
    with options.open_executor() as executor:
        assert isinstance(executor, SubmititExecutor)
        values = UnitRunner(executor, options.folder).run(units)
        lost = dict(executor.results([Call("dies once", dies, (folder, "once", 1))]))
    assert values == [{"value": i, "threads": "1"} for i in range(5)]
    assert decoded(lost[0].content) == "once" and runs(folder, "once") == 2
    script = (slurm / "100.sh").read_text()
    for line in ("--partition=cpu", "--time=7", "--mem=1536MB", "--cpus-per-task=1", "--job-name=shake"):
        assert f"#SBATCH {line}\n" in script
    assert sys.executable in script
    assert not list((tmp_path / "units").glob("submitit-*"))  # all ended well
    # What is interrupted is cancelled by Slurm.
    with pytest.raises(KeyboardInterrupt), options.open_executor() as executor:
        calls = [Call("waits", unit_calls.waits, (300.0,))]

        def stop():
            if len(list(slurm.glob("*.pid"))) > jobs:
                raise KeyboardInterrupt

        jobs = len(list(slurm.glob("*.pid")))
        list(executor.results(calls, on_tick=stop))
    assert (slurm / "cancelled").read_text().split() == [str(100 + jobs)]
