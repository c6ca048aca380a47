#!/usr/bin/env bash
# A real Slurm cluster on the loopback address, for tests and trials: one node, no accounting, no systemd.
# Usage: envs/slurm-cluster.sh ACTION FOLDER [munged|slurmctld|slurmd]
#   start   write FOLDER/slurm.conf, start the daemons, wait until the node takes work; or start one daemon again
#   stop    end the daemons by the process ids recorded in FOLDER/pids
#   kill    end one daemon at once (KILL), as a crash would
#   lose    lose the whole node: slurmd and every task on it, at once
# Settings from the environment: SLURM_CPUS and SLURM_MEMORY_MB (both the machine's own), SLURM_EXTRA (lines for slurm.conf).
# Then: SLURM_CONF=FOLDER/slurm.conf make … EXECUTOR=slurm SLURM_PROFILE=envs/slurm-cluster.toml
# FOLDER must be short: the path of a Unix socket in it ends at about 100 characters.
set -euo pipefail
PATH=$PATH:/usr/sbin:/sbin
action=${1:?action} folder=$(realpath -m "${2:?folder}") only=${3:-}
host=$(hostname -s)
export SLURM_CONF=$folder/slurm.conf

# Below the range of ephemeral ports, so that a restarted daemon finds its port still free.
free_port() {
    python3 - <<'PYTHON'
import random, socket
for port in random.sample(range(20000, 32000), 12000):
    with socket.socket() as tried:
        try:
            tried.bind(("127.0.0.1", port))
        except OSError:
            continue
    print(port)
    break
PYTHON
}

write_conf() {
    # The first two lines: Slurm's defaults would add a second to each of the tests' short tasks.
    cat >"$SLURM_CONF" <<CONF
SchedulerParameters=batch_sched_delay=0,sched_interval=1,bf_interval=1
Epilog=/bin/true
ClusterName=lab
SlurmctldHost=$host(127.0.0.1)
SlurmctldPort=$(free_port)
SlurmdPort=$(free_port)
SlurmUser=$(id -un)
SlurmdUser=$(id -un)
AuthInfo=socket=$folder/munge/m.sock,cred_expire=10
CommunicationParameters=NoCtldInAddrAny,NoInAddrAny
StateSaveLocation=$folder/state
SlurmdSpoolDir=$folder/spool
SlurmctldPidFile=$folder/pids/slurmctld.daemon
SlurmdPidFile=$folder/pids/slurmd.daemon
SlurmctldLogFile=$folder/log/slurmctld.log
SlurmdLogFile=$folder/log/slurmd.log
MpiDefault=none
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
DefMemPerCPU=50
JobAcctGatherType=jobacct_gather/linux
JobAcctGatherFrequency=1
JobAcctGatherParams=OverMemoryKill
ReturnToService=2
SlurmctldTimeout=60
SlurmdTimeout=10
KillWait=2
InactiveLimit=0
BatchStartTimeout=5
MaxJobCount=200000
SlurmdParameters=config_overrides
${SLURM_EXTRA:-}
NodeName=$host NodeAddr=127.0.0.1 CPUs=${SLURM_CPUS:-$(nproc)} RealMemory=${SLURM_MEMORY_MB:-$(free -m | awk '/^Mem/ {print $2}')} State=UNKNOWN
PartitionName=main Nodes=$host Default=YES MaxTime=INFINITE State=UP
CONF
}

launch() {  # launch NAME COMMAND…: start a daemon in its own session and record its process id
    local name=$1; shift
    setsid "$@" </dev/null >>"$folder/log/$name.out" 2>&1 &
    echo $! >"$folder/pids/$name"
}

start_one() {
    case $1 in
        munged) launch munged munged -F --force --key-file="$folder/munge/key" --socket="$folder/munge/m.sock" \
                    --pid-file="$folder/munge/pid" --log-file="$folder/log/munged.log" --seed-file="$folder/munge/seed"
                await munge_answers ;;
        slurmctld) launch slurmctld slurmctld -D -f "$SLURM_CONF"; await controller_answers ;;
        slurmd) launch slurmd slurmd -D -f "$SLURM_CONF"; await node_is_up ;;
    esac
}

munge_answers() { [ -S "$folder/munge/m.sock" ] && munge --socket="$folder/munge/m.sock" -n >/dev/null 2>&1; }
controller_answers() { timeout 2 scontrol ping 2>/dev/null | grep -q 'is UP'; }
node_is_up() { timeout 2 sinfo -h -o %t 2>/dev/null | grep -qE '^(idle|mix|alloc|comp)$'; }

await() {  # await CONDITION: up to 120 s
    for _ in $(seq 1200); do
        "$@" && return
        sleep 0.1
    done
    echo "error: $1 did not come true within 120 s; last lines of $folder/log:" >&2
    tail -n 5 "$folder"/log/* >&2
    return 1
}

alive() { kill -0 "$1" 2>/dev/null && ! grep -q '^State:.*Z' "/proc/$1/status" 2>/dev/null; }

end() {  # end NAME SIGNAL: one daemon by its recorded process id, and wait until it is gone
    local file=$folder/pids/$1 pid
    [ -f "$file" ] || return 0
    pid=$(cat "$file")
    # The process id may belong to another program by now: end it only if it is still ours.
    if alive "$pid" && grep -qa "$1" "/proc/$pid/cmdline"; then
        kill "-$2" "$pid"
        for _ in $(seq 600); do alive "$pid" || break; sleep 0.1; done
        alive "$pid" && kill -KILL "$pid"
    fi
    rm -f "$file"
}

lose() {
    end slurmd KILL
    # Every task is a child of a slurmstepd of this cluster, which its SLURM_CONF identifies.
    for proc in /proc/[0-9]*; do
        if grep -qa '^slurmstepd: \[' "$proc/cmdline" 2>/dev/null && grep -qa "SLURM_CONF=$SLURM_CONF" "$proc/environ" 2>/dev/null
        then
            kill_tree "${proc#/proc/}"
        fi
    done
}

kill_tree() {
    local child
    kill -STOP "$1" 2>/dev/null || return 0
    for child in $(cat "/proc/$1/task/$1/children" 2>/dev/null); do kill_tree "$child"; done
    kill -KILL "$1" 2>/dev/null || true
}

case $action in
    start)
        if [ -n "$only" ]; then start_one "$only"; exit; fi
        mkdir -p "$folder"/{munge,state,spool,log,pids}
        chmod 700 "$folder/munge"
        [ "${#folder}" -lt 80 ] || { echo "error: $folder is too long a path for a socket; give a shorter one" >&2; exit 2; }
        [ -f "$folder/munge/key" ] || (umask 077; head -c 1024 /dev/urandom >"$folder/munge/key")
        [ -f "$SLURM_CONF" ] || write_conf
        for daemon in munged slurmctld slurmd; do start_one "$daemon"; done ;;
    stop)
        if [ -n "$only" ]; then end "$only" TERM; exit; fi
        [ -f "$folder/pids/slurmctld" ] && timeout 5 scancel --user="$(id -un)" 2>/dev/null || true
        for daemon in slurmd slurmctld munged; do end "$daemon" TERM; done
        lose ;;
    kill) end "${only:?daemon}" KILL ;;
    lose) lose ;;
    *) echo "error: unknown action $action; one of start, stop, kill, lose" >&2; exit 2 ;;
esac
