"""A page in a real browser, and everything it complained of, asked for or did."""

from __future__ import annotations

import shutil

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
PATIENCE = 120_000
"""ms: on a busy machine a browser starts slowly."""


class Visit:
    """The page in a window, and what came of it."""

    def __init__(self, browser, path, **window):
        self.page = browser.new_page(viewport={"width": 1366, "height": 768}, **window)
        self.page.set_default_timeout(PATIENCE)
        self.complaints, self.requests, self.dialogs = [], [], []
        self.page.on("console", lambda message: self.complaints.append(message.text))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.on("dialog", self._dismiss)
        self.page.goto(path.as_uri())

    def _dismiss(self, dialog):
        self.dialogs.append(dialog.message)
        dialog.dismiss()

    def see_everything(self):
        """Scroll through the page, so that all its charts are drawn."""
        # Not awaited here: only what is waited for has a limit.
        self.page.evaluate(
            """() => void (async () => {
                for (let y = 0; y < document.documentElement.scrollHeight; y += 600) {
                    scrollTo(0, y);
                    // A busy browser may draw no frame for minutes: do not wait for one for ever.
                    await new Promise(done => { requestAnimationFrame(done); setTimeout(done, 500); });
                }
                window.allSeen = true;
            })()"""
        )
        self.page.wait_for_function("window.allSeen === true")
        self.page.wait_for_function(
            "document.querySelectorAll('figure.live').length === document.querySelectorAll('.chart-data').length"
        )

    def value(self, expression):
        return self.page.evaluate(expression)

    def is_wider_than_the_window(self):
        return self.value("document.documentElement.scrollWidth > document.documentElement.clientWidth")
