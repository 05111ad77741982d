# What happens inside the virtual machine of tests/power_cuts.rs. Programs write to an ext4 whose device keeps a log of all
# writes; the log also has marks: what was reported when, and the time. Then the disk is made as it was after a power cut at
# many moments, mounted, and listed.

# The program with the libraries of the host.
cat >/bin/gapwatch <<'END_OF_PROGRAM'
#!/bin/sh
exec /tmp/lib/ld-linux-x86-64.so.2 --library-path /tmp/lib /tmp/gapwatch "$@"
END_OF_PROGRAM
chmod +x /bin/gapwatch

# mark WORD: into the log of writes, without a space.
mark() { dmsetup message disk 0 mark "$1"; }

# listing FOLDER: everything below it.
listing() (
  cd "$1" || exit
  find . -type d | sed 's/^/folder /'
  find . -type f -exec stat -c 'bytes %s %n' {} +
  find . -type f -exec sha256sum {} + | sed 's/^/sha256 /'
)

lines() { if [ -e "$1" ]; then wc -l <"$1"; else echo 0; fi; }

# Marks the time, and how many lines the monitor has written until then, twice a second.
clock() {
  while [ ! -e quiet ]; do
    read -r now _ </proc/uptime
    mark "clock:$now:$(lines /disk/monitor/live.jsonl):$(lines /disk/monitor/live.log)"
    sleep .5
  done
}

# written FOLDER COMMAND: runs a program that writes into a folder and has reported that when it ends.
count=0
written() {
  folder=$1
  shift
  count=$((count + 1))
  "$@" >$count.out 2>$count.err
  code=$?
  mark "written:$count:$folder"
  echo $code >$count.code
  listing /disk >$count.list
}

# random N: `drawn` becomes 0 to N-1.
random() {
  seed=$(((seed * 1103515245 + 12345) & 0x7fffffff))
  drawn=$((seed / 65536 % $1))
}

# moments COUNT: as many different ones, after the mark `begin` and up to `end`; every fourth lies around a report.
moments() {
  begin=$(sed -n 's/ begin$//p' marks)
  end=$(sed -n 's/ end$//p' marks)
  reports=$(sed -n 's/ written:.*//p' marks)
  : >moments
  tried=0
  while [ "$(wc -l <moments)" -lt "$1" ]; do
    tried=$((tried + 1))
    if [ $((tried % 4)) -eq 0 ]; then
      random $count
      # shellcheck disable=SC2086
      at=$(echo $reports | cut -d' ' -f$((drawn + 1)))
      random 9
      at=$((at + drawn - 3))
    else
      random $((end - begin))
      at=$((begin + 1 + drawn))
    fi
    [ $at -gt "$begin" ] && [ $at -le "$end" ] && ! grep -qx $at moments && echo $at >>moments
  done
}

cp -r /share/* .
read -r seed wanted <cuts
modprobe brd rd_nr=2 rd_size=131072
modprobe dm-log-writes
modprobe ext4
modprobe loop
disk_kib=24576
mkfs.ext4 -q -b 4096 -E lazy_itable_init=0,lazy_journal_init=0 before ${disk_kib}k
cat before >/dev/ram0
echo "0 $((2 * disk_kib)) log-writes /dev/ram0 /dev/ram1" | dmsetup create disk --noudevsync || exit 3
mkdir /disk /cut
mount -t ext4 /dev/dm-0 /disk || exit 3
mkdir /disk/unsynced /disk/calibrate /disk/replay /disk/report /disk/monitor
# A journal of an earlier run; its line does not count.
printf earlier >/disk/monitor/live.jsonl
sync

mark begin
clock &
clock=$!
replay() {
  gapwatch replay "$1" --model lane.onnx --reference reference.json --evidence /disk/replay/seen \
    --journal /disk/replay/drive.jsonl --can log:/disk/replay/drive.log --mcap /disk/replay/drive.mcap
}
calibrate() {
  gapwatch calibrate --model lane.onnx --sim nominal-*.mcap --surveys /disk/calibrate/own.surveys --out /disk/calibrate/own.json
}
written monitor true
# The file that nobody syncs shows whether this finds anything.
written unsynced cp reference.json /disk/unsynced/
sleep 12
written calibrate calibrate
sleep 12
written replay replay short.mcap
sleep 12
written report gapwatch report /disk/replay/drive.jsonl --evidence /disk/replay/seen --out /disk/report/drive.html
sleep 12
written monitor gapwatch monitor --board car.toml --journal /disk/monitor/live.jsonl
cp /disk/monitor/live.* .
sleep 15
# In the place of what is there.
written replay replay other.mcap
sleep 3
mark end
touch quiet
wait $clock
# Marks are written by a thread of the kernel.
sleep 1
power-cut /dev/ram1 >marks || exit 3
moments "$wanted"

mkdir live
number=0
while read -r at; do
  number=$((number + 1))
  # Every second time the disk's own cache is lost too.
  power-cut /dev/ram1 before after "$at" $((number % 2 * number))
  echo "cut $at"
  mount -t ext4 -o loop after /cut || exit 4
  listing /cut
  for kind in jsonl log; do
    file=/cut/monitor/live.$kind
    [ ! -e $file ] || cp $file live/"$at".$kind
  done
  umount /cut
done <moments >cuts.list
cp -r marks moments live live.* ./*.out ./*.err ./*.code ./*.list /share/
