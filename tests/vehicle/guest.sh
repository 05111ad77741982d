# What happens inside the emulated car computer: the package is installed, its service started and watched, and removed. What
# is to be judged goes to /share.
capture="v4l2-ctl -d /dev/video0"
output="v4l2-ctl -d /dev/video1"
unit=gapwatch@car.service

# done_as NAME COMMAND: keeps what it said and its exit code.
done_as() {
  name=$1
  shift
  "$@" >"$name.out" 2>&1
  echo $? >"$name.code"
}
play() { $output --stream-out-mmap=4 --stream-from=- >/dev/null 2>&1; }
property() { systemctl show -P "$1" $unit; }
traces() {
  find / -xdev -iname '*gapwatch*' -not -path '/proc/*' -not -path '/root/*' -not -path '/var/log/journal/*' \
    -not -path '/run/log/journal/*' | sort
}

modprobe vcan echo=1
modprobe can-raw
modprobe vivid n_devs=1 node_types=0x101 num_inputs=1 input_types=0x3 num_outputs=1 output_types=0x1
ip link add vcan0 type vcan
ip link set vcan0 up
udevadm settle
# 1280x720 at 30 frames a second; frames of another size are scaled on their way in and back on their way out.
for node in "$capture" "$output"; do $node --set-dv-bt-timings index=5 >/dev/null; done
$capture -c osd_text_mode=2 -c loop_video=1
$output --set-fmt-video-out=width=320,height=160,pixelformat=YUYV

traces >before.out
find / -xdev -not -path '/proc/*' -not -path '/root/*' | sort >files-before.log
done_as install dpkg -i gapwatch.deb
if [ "$(cat install.code)" != 0 ]; then
  cp ./*.out ./*.code /share/
  exit 1
fi
done_as version gapwatch --version
done_as listed dpkg -L gapwatch
cp /usr/share/gapwatch/boards/emulated-arm64.toml /etc/gapwatch/car.toml
printf '[evidence]\nfolder = "/var/lib/gapwatch/seen"\n' >>/etc/gapwatch/car.toml
done_as replay gapwatch replay short --journal replay.jsonl

while [ ! -e quiet ]; do cat nominal; done | play &
playing=$!
sleep 1
done_as doctor gapwatch doctor --board /etc/gapwatch/car.toml
touch quiet
wait $playing

candump -L vcan0 >bus.log 2>/dev/null &
logging=$!
cat nominal drive | play &
playing=$!
sleep .3
# Comes back when the first frame is judged.
done_as enable systemctl enable --now $unit
property ActiveState >active.out
pid=$(property MainPID)
grep -E 'VmRSS|VmHWM|Threads|Uid|CapEff|NoNewPrivs|Seccomp:' /proc/$pid/status >process.out
wait $playing
grep -E 'VmRSS|VmHWM' /proc/$pid/status >process-after.out
property StatusText >status.out

# An upgrade runs the new program without being asked.
done_as upgrade dpkg -i gapwatch.deb
sleep 2
property ActiveState >upgraded.out
echo "$pid $(property MainPID)" >>upgraded.out

# One that hangs is started anew.
pid=$(property MainPID)
kill -STOP $pid
sleep 14
echo "$pid $(property MainPID) $(property ActiveState) $(property NRestarts)" >hung.out

done_as stop systemctl stop $unit
property Result >stopped.out
sleep .2
kill -INT $logging
wait $logging
journalctl -u $unit -o json --output-fields=PRIORITY,MESSAGE --no-pager >journal.out
systemd-analyze security $unit --no-pager 2>/dev/null | tail -1 >security.out

find -L /var/lib/gapwatch -type f >evidence.out
done_as remove dpkg -r gapwatch
traces >removed.out
ls /etc/gapwatch >kept.out
done_as purge dpkg -P gapwatch
traces >purged.out
find / -xdev -not -path '/proc/*' -not -path '/root/*' | sort >files-after.log
cp ./*.out ./*.code ./*.log replay.jsonl /share/
