"""The report in a real browser: opened from a file, used, printed, without an error or a request (about 15 s)."""

import pytest

from .browsing import PATIENCE, Visit

pytestmark = pytest.mark.slow

pytest.importorskip("plotly", reason="needs plotly (extra report)")

SCREENS = [(1366, 768), (1280, 800)]


@pytest.fixture(scope="module")
def path(report_of_five):
    return report_of_five


@pytest.fixture(scope="module")
def opened(browser, path):
    visit = Visit(browser, path)
    visit.see_everything()
    yield visit
    visit.page.close()


@pytest.fixture
def visit(opened):
    """The page with all its charts drawn, in a light window whatever the test before made of it."""
    opened.page.emulate_media(media="screen", color_scheme="light")
    opened.page.set_viewport_size({"width": 1366, "height": 768})
    return opened


@pytest.mark.parametrize(("width", "height"), SCREENS)
def test_the_first_screen_holds_headline_and_answers(visit, five_filters, width, height):
    visit.page.set_viewport_size({"width": width, "height": height})
    visit.value("scrollTo(0, 0)")
    boxes = visit.value(
        """[...document.querySelectorAll("h1, .headline, .answers th, .answers td")]
            .map(part => part.getBoundingClientRect()).map(({right, bottom}) => [right, bottom])"""
    )
    assert len(boxes) == 2 + 6 + len(five_filters) * 6
    assert max(right for right, _ in boxes) <= width
    assert max(bottom for _, bottom in boxes) <= height
    assert not visit.is_wider_than_the_window()


def test_every_chart_is_drawn_without_a_complaint_or_a_request(visit, path):
    assert visit.value("document.querySelectorAll('figure .main-svg').length") > 0
    assert visit.value("document.querySelectorAll('figure').length") == 19
    assert visit.complaints == []
    assert visit.requests == [path.as_uri()]


def test_a_table_sorts_by_click_and_by_key(visit):
    names = "[...document.querySelectorAll('.answers tbody th')].map(head => head.dataset.value)"
    values = "[...document.querySelectorAll('.answers tbody tr')].map(row => Number(row.cells[1].dataset.value))"
    head = visit.page.locator(".answers thead th").nth(1)
    head.locator("button").click()
    assert visit.value(values) == sorted(visit.value(values))
    assert head.get_attribute("aria-sort") == "ascending"
    first = visit.value(names)
    head.locator("button").press("Enter")
    assert head.get_attribute("aria-sort") == "descending"
    assert visit.value(names) == first[::-1]


def test_a_series_is_switched_off_in_all_panels_and_on_again(visit):
    shown = """[...document.querySelector("#figure-velocity .chart").data]
        .filter(trace => trace.name === "euclidean").map(trace => trace.visible !== false)"""
    noted = 'document.querySelector("#figure-velocity .chart").layout.annotations.some(a => a.name === "euclidean")'
    key = visit.page.locator("#figure-velocity .keys button", has_text="euclidean")
    assert (visit.value(shown), visit.value(noted)) == ([True] * 3, True)
    key.click()
    assert key.get_attribute("aria-pressed") == "false"
    assert (visit.value(shown), visit.value(noted)) == ([False] * 3, False)
    key.press("Enter")
    assert (visit.value(shown), visit.value(noted)) == ([True] * 3, True)


def test_hovering_says_series_value_and_unit(visit, five_filters):
    chart = visit.page.locator("#figure-time_per_frame .chart")
    chart.scroll_into_view_if_needed()
    box = chart.bounding_box()
    for share in (0.6, 0.55, 0.5, 0.45, 0.4, 0.65, 0.7):
        visit.page.mouse.move(box["x"] + 0.25 * box["width"], box["y"] + share * box["height"])
        visit.page.wait_for_timeout(80)
        said = visit.value("[...document.querySelectorAll('.hovertext')].map(label => label.textContent).join(' ')")
        if said:
            break
    assert " ms" in said
    assert any(behaviour.name in said for behaviour in five_filters)


def test_colours_follow_the_page_from_light_to_dark(visit):
    colours = """() => [getComputedStyle(document.body).backgroundColor,
        document.querySelector("#figure-velocity .chart").data.find(trace => trace.name === "euclidean").line.color]"""
    visit.page.locator("#figure-velocity").scroll_into_view_if_needed()
    light = visit.value(colours)
    visit.page.emulate_media(color_scheme="dark")
    visit.page.wait_for_function(f"({colours})()[1] !== '{light[1]}'")
    dark = visit.value(colours)
    assert all(a != b for a, b in zip(light, dark, strict=True))
    assert visit.complaints == []


def test_a_phone_does_not_scroll_sideways(visit):
    visit.page.set_viewport_size({"width": 390, "height": 844})
    assert not visit.is_wider_than_the_window()


def test_in_print_the_drawings_take_the_place_of_the_charts(visit):
    visit.page.emulate_media(media="print")
    shown = "document.querySelector('#figure-nees {}').getBoundingClientRect().height > 100"
    assert visit.value(shown.format(".stage > svg"))
    assert not visit.value(shown.format(".chart"))
    visit.page.emulate_media(media="screen")
    printed = visit.page.pdf(format="A4")
    assert printed.startswith(b"%PDF")
    assert len(printed) > 50_000
    assert visit.complaints == []


def test_without_javascript_the_drawings_and_tables_are_there(browser, path, five_filters):
    context = browser.new_context(java_script_enabled=False, color_scheme="dark")
    page = context.new_page()
    page.set_default_timeout(PATIENCE)
    page.goto(path.as_uri())
    assert page.locator("figure svg").first.is_visible()
    assert page.locator(".answers tbody tr").count() == len(five_filters)
    context.close()
