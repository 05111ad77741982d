"""Opens a report in Chromium: no error on the console, numbers equal to the journal, alarms open by click and by key.

usage: check_report.py JOURNAL REPORT.html [FOLDER for screenshots]
"""

import base64
import json
import os
import sys
import tempfile
from itertools import dropwhile, groupby
from pathlib import Path

from selenium import webdriver
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys

FLAGS = [
    "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-dev-shm-usage",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--hide-scrollbars",
]
SIZES = {"light": (1200, 900), "dark": (1200, 900), "phone": (390, 844)}
KINDS = {"Suspect": "Gap", "Gap": "Gap", "SensorFault": "SensorFault", "Unavailable": "Unavailable"}


def browser(profile):
    options = webdriver.ChromeOptions()
    options.binary_location = os.environ.get("CHROMIUM", "/usr/bin/chromium")
    for flag in [*FLAGS, f"--user-data-dir={profile}"]:
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    service = webdriver.ChromeService(os.environ.get("CHROMEDRIVER", "/usr/bin/chromedriver"))
    return webdriver.Chrome(options=options, service=service)


def emulate(page, size, scheme):
    width, height = size
    page.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600},
    )
    page.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [{"name": "prefers-color-scheme", "value": scheme}]})


def text(page, selector):
    return page.find_element(By.CSS_SELECTOR, selector).text


def is_end(line):
    """The line that says that the monitor stopped."""
    return line["reason"] == "stopped"


def largest(lines, key, shown):
    values = [line[key] for line in lines if line.get(key) is not None]
    return shown(max(values)) if values else "–"


def cause_of(lines):
    """The cause with the largest mean probability, over the lines that name one."""
    named = [line for line in lines if line.get("cause") is not None]
    sums = {}
    for line in named:
        sums[line["cause"]] = sums.get(line["cause"], 0) + line["cause_probability"]
    if not sums:
        return "–"
    cause = max(sums, key=sums.get)
    return f"{cause} ({100 * sums[cause] / len(named):.0f} %)"


def alarms_of(lines):
    """Alarms as the journal has them: stretches of one kind of trouble. A gap begins with its first line in Gap."""
    alarms, place = [], 0
    for kind, stretch in groupby(lines, key=lambda line: None if is_end(line) else KINDS.get(line["state"])):
        stretch = list(stretch)
        place += len(stretch)
        if kind:
            inside = list(dropwhile(lambda line: line["state"] != kind, stretch)) or stretch
            begin = inside[0]["t_s"]
            scored = [line for line in stretch if line["score"] is not None]
            worst = max(scored, key=lambda line: line["score"], default=None)
            scores = {tap: s for tap, s in ((worst or {}).get("tap_score") or {}).items() if s is not None}
            end = lines[min(place, len(lines) - 1)]["t_s"]
            alarms.append([
                "Suspect" if all(line["state"] == "Suspect" for line in stretch) else kind,
                f"{begin:.1f} s",
                f"{end:.1f} s" + (" (end)" if all(map(is_end, lines[place:])) else ""),
                f"{end - begin:.1f} s",
                largest(stretch, "gap", "{:.2f}".format),
                largest(stretch, "change", "{:.2f}".format),
                largest(stretch, "lanes", lambda share: f"{100 * share:.0f} %"),
                cause_of(inside),
                max(scores, key=scores.get) if scores else "–",
                ", ".join(dict.fromkeys(l["reason"] for l in stretch if l["reason"] != "none")) or "–",
            ])
    return alarms


def check_numbers(page, lines):
    span = lines[-1]["t_s"] - lines[0]["t_s"]
    spent = {}
    for line, after in zip(lines, lines[1:]):
        spent[line["state"]] = spent.get(line["state"], 0) + after["t_s"] - line["t_s"]
    scores = [line["score"] for line in lines if line["score"] is not None]
    assert text(page, "#span") == f"{span:.1f} s"
    assert text(page, "#in-gap") == f"{spent.get('Gap', 0):.1f} s"
    assert text(page, "#score-max") == (f"{max(scores):.2f}" if scores else "–")
    latencies = sorted(line["latency_ms"] for line in lines if line["seq"] is not None)
    assert text(page, "#latency") == f"{latencies[-(-len(latencies) // 2) - 1]:.1f} ms"

    rows = page.find_elements(By.CSS_SELECTOR, "#shares tbody tr")
    shares = {}
    for row in rows:
        cells = [cell.text for cell in row.find_elements(By.TAG_NAME, "td")]
        shares[cells[0].split()[-1]] = cells[1:3]
    assert set(shares) == {line["state"] for line in lines if not is_end(line)}, shares
    for state, (seconds, share) in shares.items():
        wanted = spent.get(state, 0)
        assert (seconds, share) == (f"{wanted:.1f} s", f"{100 * wanted / span:.1f} %"), (state, seconds, share)

    unjudged = {}
    for line in lines:
        if line["gap"] is None and not is_end(line):
            why = line["reason"] if line["health"] == "ok" else line["health"]
            unjudged[why] = unjudged.get(why, 0) + 1
    said = [item.text for item in page.find_elements(By.CSS_SELECTOR, "#unjudged li")]
    assert sorted(said) == sorted(f"{why}: {count}" for why, count in unjudged.items()), said

    drawn = json.loads(page.find_element(By.ID, "data").get_attribute("textContent"))
    assert drawn["t"] == [line["t_s"] for line in lines]
    for key in ("gap", "change", "lanes"):
        assert drawn[key] == [line.get(key) for line in lines], key
    assert drawn["probability"] == [line.get("cause_probability") for line in lines]
    assert [k if k is None else drawn["causes"][k] for k in drawn["cause"]] == [line.get("cause") for line in lines]
    titles = [title.get_attribute("textContent") for title in page.find_elements(By.CSS_SELECTOR, "#charts .title")]
    for title, key in (("Scores", "change"), ("Likely cause", "cause"), ("Lanes lost, forecast, %", "lanes")):
        assert (title in titles) == any(line.get(key) is not None for line in lines), titles
    for tap in drawn["taps"]:
        assert tap["gap"] == [line["tap_gap"][tap["name"]] for line in lines]


def check_alarms(page, lines):
    wanted = alarms_of(lines)
    rows = page.find_elements(By.CSS_SELECTOR, "tr.alarm")
    assert len(rows) == len(wanted)
    for row, alarm in zip(rows, wanted):
        cells = [cell.text for cell in row.find_elements(By.TAG_NAME, "td")]
        cells[0] = cells[0].split()[-1]
        assert cells == alarm, (cells, alarm)
    for by_key, row in zip([False, True] * len(rows), rows):
        button = row.find_element(By.TAG_NAME, "button")
        behind = page.find_element(By.ID, button.get_attribute("aria-controls"))
        assert not behind.is_displayed() and button.get_attribute("aria-expanded") == "false"
        button.send_keys(Keys.ENTER) if by_key else button.click()
        assert behind.is_displayed() and button.get_attribute("aria-expanded") == "true"
        assert behind.find_elements(By.CSS_SELECTOR, ".closer svg"), "no closer look"
        assert behind.find_elements(By.CSS_SELECTOR, ".lines tbody tr"), "no lines"
        for image in behind.find_elements(By.TAG_NAME, "img"):
            assert page.execute_script("return arguments[0].naturalWidth", image) > 0, "a broken picture"
            assert image.get_attribute("alt")
        button.send_keys(Keys.SPACE) if by_key else button.click()
        assert not behind.is_displayed()


def check_evidence(page):
    """Every alarm with pictures has a drawing a tap: bars, and the grid of regions with shares that sum to 100."""
    for behind in page.find_elements(By.CSS_SELECTOR, "tr.behind"):
        pictures = behind.find_elements(By.CSS_SELECTOR, ".evidence img[alt^=Energies]")
        drawings = behind.find_elements(By.CSS_SELECTOR, ".profiles figure")
        assert bool(pictures) == bool(drawings), f"{len(pictures)} heat maps, {len(drawings)} drawings"
        for drawing in drawings:
            assert len(drawing.find_elements(By.CSS_SELECTOR, ".profile rect.live")) >= 16
            numbers = drawing.find_elements(By.CSS_SELECTOR, ".regions text")
            shares = [int(number.get_attribute("textContent")) for number in numbers]
            assert len(shares) == 16 and 92 <= sum(shares) <= 108, shares


def check_print(page):
    """On paper every alarm is open, nothing is cut off at the right, and there are no buttons."""
    # A browser says so before it lays out the paper.
    page.execute_script("window.dispatchEvent(new Event('beforeprint'))")
    page.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    drawn_for = lambda svg: float(svg.get_dom_attribute("viewBox").split()[2])
    chart = drawn_for(page.find_element(By.CSS_SELECTOR, "#charts svg"))
    for behind in page.find_elements(By.CSS_SELECTOR, "tr.behind"):
        assert behind.is_displayed()
        closer = behind.find_elements(By.CSS_SELECTOR, ".closer svg")
        assert closer, "no closer look"
        assert drawn_for(closer[0]) >= 0.8 * chart, "drawn for another width, so scaled on paper"
    wide = page.execute_script("return document.documentElement.scrollWidth - document.documentElement.clientWidth")
    assert wide <= 0, f"{wide} pixels too wide"
    assert not page.find_element(By.ID, "in").is_displayed()
    pdf = base64.b64decode(page.execute_cdp_cmd("Page.printToPDF", {"printBackground": True})["data"])
    assert pdf.startswith(b"%PDF") and len(pdf) > 10_000
    page.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})
    return pdf


def check_zoom(page):
    assert text(page, "#range") == ""
    zoom = page.find_element(By.ID, "in")
    assert zoom.get_attribute("aria-label")
    zoom.click()
    assert text(page, "#range").startswith("Shown: ")
    charts = page.find_element(By.ID, "charts")
    before = text(page, "#range")
    charts.send_keys(Keys.ARROW_RIGHT)
    assert text(page, "#range") != before
    charts.send_keys("0")
    assert text(page, "#range") == ""


def shoot(page, folder):
    for name, size in SIZES.items():
        emulate(page, size, "dark" if name == "dark" else "light")
        for row in page.find_elements(By.CSS_SELECTOR, "tr.alarm button[aria-expanded=false]")[:1]:
            page.execute_script("arguments[0].click()", row)
        page.execute_script("window.dispatchEvent(new Event('resize'))")
        height = page.execute_script("return document.documentElement.scrollHeight")
        emulate(page, (size[0], height), "dark" if name == "dark" else "light")
        page.save_screenshot(str(Path(folder) / f"{name}.png"))


def main():
    journal, report = sys.argv[1:3]
    # The first line says what the run was made with.
    lines = [json.loads(line) for line in Path(journal).read_text().splitlines()[1:]]
    with tempfile.TemporaryDirectory() as profile:
        page = browser(profile)
        try:
            for size in SIZES.values():
                emulate(page, size, "light")
                page.get(Path(report).resolve().as_uri())
                wide = page.execute_script("return document.documentElement.scrollWidth")
                assert wide <= size[0], f"{wide} pixels wide on a screen of {size[0]}"
                if size[0] > 600:
                    check_numbers(page, lines)
                    check_alarms(page, lines)
                check_zoom(page)
            check_evidence(page)
            emulate(page, SIZES["light"], "light")
            pdf = check_print(page)
            assert page.execute_script("return window.hacked") is None
            if len(sys.argv) > 3:
                shoot(page, sys.argv[3])
                (Path(sys.argv[3]) / "print.pdf").write_bytes(pdf)
            errors = page.get_log("browser")
            assert not errors, errors
            asked = [json.loads(entry["message"])["message"] for entry in page.get_log("performance")]
            asked = [m["params"]["request"]["url"] for m in asked if m["method"] == "Network.requestWillBeSent"]
            # chrome: is the empty tab that the browser opens with.
            outside = [url for url in asked if not url.startswith(("file:", "data:", "chrome:"))]
            assert not outside, outside
        finally:
            page.quit()
    print(f"{len(lines)} lines, {len(alarms_of(lines))} alarms")


if __name__ == "__main__":
    main()
