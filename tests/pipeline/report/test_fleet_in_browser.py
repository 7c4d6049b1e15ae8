"""The fleet's page in headless Chromium, opened from the file system."""

from __future__ import annotations

from pathlib import Path

from selenium.webdriver import Chrome
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import Select

from tests.pipeline.report.browser import needs_browser, shown, text, visit, wait
from tests.pipeline.report.judged import HEALTHY, NIGHTS, NOTE, REASON, WORN

MOTORS = 6

pytestmark = needs_browser


def test_all_motors_are_listed_and_filtered_by_text_type_and_state(
    browser: Chrome, report: Path
) -> None:
    visit(browser, report / "index.html")
    every = shown(browser)
    assert len(every) == MOTORS
    pictures = browser.find_elements(By.CSS_SELECTOR, "td svg.sparkline")
    assert len(pictures) == MOTORS
    assert all(one.get_attribute("aria-label").startswith("Drain flow ") for one in pictures)
    find = browser.find_element(By.ID, "find")
    find.send_keys("cb560")
    assert sorted(shown(browser)) == ["CB560-01", "CB560-02"]
    assert browser.find_element(By.ID, "shown").text == f"2 of {MOTORS} shown"
    find.send_keys("-02")
    assert shown(browser) == ["CB560-02"]
    find.send_keys(" nothing")
    assert shown(browser) == []
    browser.find_element(By.ID, "reset").click()
    wait(browser, "return document.getElementById('nothing').hidden")
    assert shown(browser) == every
    Select(browser.find_element(By.ID, "type")).select_by_visible_text("CB1120")
    assert sorted(shown(browser)) == ["CB1120-01", "CB1120-02"]
    for box in browser.find_elements(By.NAME, "state"):
        box.click()
    assert shown(browser) == []


def test_sort_with_the_worst_first_and_what_is_absent_last(browser: Chrome, told: Path) -> None:
    visit(browser, told / "index.html")
    headers = browser.find_elements(By.CSS_SELECTOR, "#fleet thead th")
    header = headers[3]
    assert header.text.startswith("Leakage")
    button = header.find_element(By.TAG_NAME, "button")
    button.send_keys(Keys.ENTER)
    assert header.get_dom_attribute("aria-sort") == "descending"
    assert shown(browser)[:2] == [WORN, HEALTHY]
    button.send_keys(Keys.SPACE)
    assert header.get_dom_attribute("aria-sort") == "ascending"
    assert shown(browser)[:2] == [HEALTHY, WORN]
    headers[0].find_element(By.TAG_NAME, "button").click()
    assert shown(browser)[:2] == ["CB400-01", "CB400-02"]


def test_filters_and_order_stand_in_the_address(browser: Chrome, report: Path) -> None:
    visit(browser, report / "index.html")
    browser.find_element(By.ID, "find").send_keys("cb560")
    browser.find_element(By.CSS_SELECTOR, "#fleet thead th button").click()
    address = browser.current_url
    seen = shown(browser)
    visit(browser, report / "index.html", address.partition("index.html")[2])
    assert shown(browser) == seen == ["CB560-01", "CB560-02"]
    assert browser.find_element(By.ID, "find").get_property("value") == "cb560"
    visit(browser, report / "index.html", "#state=none&sort=99%20up&type=%E0<b>")
    assert shown(browser) == []


def test_a_motor_s_page_is_reached_by_keyboard(browser: Chrome, report: Path) -> None:
    visit(browser, report / "index.html")
    browser.find_element(By.LINK_TEXT, "CB560-01").send_keys(Keys.ENTER)
    assert wait(browser, "return document.body.dataset.night") == NIGHTS[-1]
    assert browser.find_element(By.TAG_NAME, "h1").text == "CB560-01"
    browser.find_element(By.CSS_SELECTOR, "header nav a").click()
    assert len(shown(browser)) == MOTORS


def test_what_needs_attention_is_on_top_with_its_sentence(browser: Chrome, told: Path) -> None:
    visit(browser, told / "index.html")
    assert shown(browser)[0] == WORN
    (item,) = browser.find_elements(By.CSS_SELECTOR, ".attention li")
    assert item.get_dom_attribute("data-motor") == WORN
    said = f"alarm\n{WORN}\nL{REASON[1:]}. Look at the balance sleeve at the next stop."
    assert said in item.text
    assert f"Acknowledged: {NOTE}" in item.text
    # Who is searched for leaves the others above the table, too.
    browser.find_element(By.ID, "find").send_keys("3 of 8")
    assert not item.is_displayed()
    # Motors without a baseline show what they have.
    assert "measured" in text(browser, "tr[data-motor='CB1120-01'] td:nth-child(4)")
    # 11 UTC is noon in the fleet's zone; all is long ago.
    old = [one.text for one in browser.find_elements(By.CSS_SELECTOR, "header time.old")]
    assert old[0].startswith("2026-01-05 12:00 (")
    assert old[0].endswith(" days ago)")
    assert len(browser.find_elements(By.CSS_SELECTOR, "#fleet time.old")) == MOTORS
