//! What the page may ask for, and what it gets.

use std::{path::PathBuf, sync::Arc, time::Duration};

use netcord_calib::{gather, session::SessionFolder};

use super::{
    desk::{Command, Desk},
    guard::Guard,
    http::{Request, Response},
    picture,
    result::ResultPage,
};

/// Width of preview pictures, px.
const PREVIEW_WIDTH: usize = 960;
/// Width of pictures that are looked at closely, px.
const VIEW_WIDTH: usize = 1280;
/// How long a page waits for news before it asks again.
const PATIENCE: Duration = Duration::from_secs(5);

/// Answers the page.
#[derive(Debug)]
pub struct Routes {
    /// Who may ask.
    pub guard: Guard,
    /// Where the engine is.
    pub desk: Arc<Desk>,
    /// Cameras, by place.
    pub cameras: Vec<String>,
    /// Kept pictures.
    pub folder: SessionFolder,
}

fn script(text: &'static str) -> Response {
    Response::of("text/javascript; charset=utf-8", text)
}

impl Routes {
    /// The answer to a request.
    pub fn answer(&self, request: &Request) -> Response {
        match self.guard.admit(request) {
            Ok(path) => self.route(path, request),
            Err(refusal) => refusal,
        }
    }

    fn route(&self, path: &str, request: &Request) -> Response {
        match (request.method.as_str(), path) {
            ("GET", "") => Response::of("text/html; charset=utf-8", include_str!("page/index.html")),
            ("GET", "page.css") => Response::of("text/css; charset=utf-8", include_str!("page/page.css")),
            ("GET", "icon.svg") => Response::of("image/svg+xml", include_str!("page/icon.svg")),
            ("GET", "page.js") => script(include_str!("page/page.js")),
            ("GET", "cameras.js") => script(include_str!("page/cameras.js")),
            ("GET", "review.js") => script(include_str!("page/review.js")),
            ("GET", "state") => {
                let after = request.query("after").and_then(|v| v.parse().ok()).unwrap_or(0);
                Response::json(self.desk.state_after(after, PATIENCE).as_bytes())
            }
            ("GET", "picture") => self.picture(request),
            ("GET", "result") => {
                let shown = self.desk.published().shown.clone();
                match shown {
                    Some(shown) => match serde_json::to_vec(&ResultPage::of(&shown)) {
                        Ok(json) => Response::json(json),
                        Err(e) => Response::text(500, e.to_string()),
                    },
                    None => Response::text(404, "There is no result yet."),
                }
            }
            ("GET", "view") => self.view(request).unwrap_or_else(|why| Response::text(404, why)),
            ("POST", "act") => match serde_json::from_slice::<Command>(&request.body) {
                Ok(command) => match self.desk.ask(command) {
                    Ok(()) => Response::json("{}"),
                    Err(why) => Response::text(409, why),
                },
                Err(e) => Response::text(400, format!("This is no command: {e}.")),
            },
            (_, "act") | ("POST", _) => Response::text(405, "Commands are POSTed to act; all else is GET."),
            _ => Response::text(404, "There is nothing here."),
        }
    }

    /// A camera's picture in one of the newest shots, in the newest where none is named.
    fn picture(&self, request: &Request) -> Response {
        let camera = self.cameras.iter().position(|c| Some(c.as_str()) == request.query("camera"));
        let width = request.query("width").and_then(|w| w.parse().ok()).unwrap_or(PREVIEW_WIDTH);
        let width = width.clamp(64, 4 * PREVIEW_WIDTH);
        let wanted = request.query("shot").and_then(|n| n.parse::<u64>().ok());
        let luma = camera.and_then(|c| {
            let published = self.desk.published();
            let mut shots = published.pictures.iter().rev();
            let shot = shots.find(|(number, _)| wanted.is_none_or(|w| w == *number));
            shot.and_then(|(_, pictures)| pictures.get(c).cloned().flatten())
        });
        match luma.map(|luma| picture::jpeg(&luma, width)) {
            Some(Ok(jpeg)) => Response::of("image/jpeg", jpeg),
            Some(Err(e)) => Response::text(500, e.to_string()),
            None => Response::text(404, "There is no picture of this camera yet."),
        }
    }

    /// The picture of a kept view, raw or undistorted.
    fn view(&self, request: &Request) -> Result<Response, String> {
        let (task, shown) = {
            let published = self.desk.published();
            (published.task, published.shown.clone())
        };
        let task = task.ok_or("There is no task yet.")?;
        let (shot, camera) = (request.query("shot"), request.query("camera"));
        let camera =
            self.cameras.iter().find(|c| Some(c.as_str()) == camera).ok_or("There is no such camera.")?;
        let path: Option<PathBuf> =
            self.folder.picture(task, shot.unwrap_or_default(), camera).map_err(|e| e.to_string())?;
        let mut luma = gather::read(&path.ok_or("There is no such view.")?).map_err(|e| e.to_string())?;
        if request.query("undistorted").is_some() {
            let model = shown.as_ref().and_then(|s| s.outcome.model(camera)).copied();
            let model = model.ok_or("There is no result to undistort with yet.")?;
            luma = picture::undistorted(&luma, &model).ok_or("The picture is empty.")?;
        }
        let width = request.query("width").and_then(|w| w.parse().ok()).unwrap_or(VIEW_WIDTH);
        let jpeg = picture::jpeg(&luma, width.clamp(64, VIEW_WIDTH)).map_err(|e| e.to_string())?;
        Ok(Response::of("image/jpeg", jpeg))
    }
}
