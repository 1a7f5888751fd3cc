//! How many connections there are at once, and which one goes where there are too many.
//!
//! The oldest goes and the newest stays, each among its own kind. Were newcomers refused in place of that, whoever sat idle first would keep the page from
//! its user for as long as they may sit. Connections without the token never take the place of one that has shown it.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use tokio::task::AbortHandle;

/// What a connection has shown of itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// Nothing yet. Its first bytes may be on their way, so there may be many.
    Silent,
    /// Something, and not the token.
    Stranger,
    /// A request with the token.
    Known,
    /// It is a stream of events.
    Stream,
}

impl Kind {
    /// All kinds, in their order.
    pub(super) const ALL: [Self; 4] = [Self::Silent, Self::Stranger, Self::Known, Self::Stream];

    /// Connections of it at once: together fewer than the 1024 descriptors that most systems give a program. Where there are fewer, [`Room::spare`] sees to
    /// that.
    pub(super) fn most(self) -> usize {
        match self {
            Self::Silent => 256,
            Self::Stranger | Self::Known => 64,
            Self::Stream => 32,
        }
    }
}

/// Connections that go where descriptors are short, so that some are left for files, too.
const SPARED: usize = 8;

/// A connection's task.
#[derive(Debug)]
struct Seated {
    id: u64,
    end: AbortHandle,
}

/// All connections, each kind from the one heard of longest ago.
#[derive(Debug)]
pub(super) struct Room {
    kinds: Mutex<[Queue; Kind::ALL.len()]>,
}

/// Connections of one kind, and how many there may be.
#[derive(Debug)]
struct Queue {
    places: VecDeque<Seated>,
    most: usize,
}

impl Default for Room {
    fn default() -> Self {
        Self { kinds: Mutex::new(Kind::ALL.map(|kind| Queue { places: VecDeque::new(), most: kind.most() })) }
    }
}

impl Room {
    /// Takes the task of a new connection in.
    pub(super) fn enter(&self, id: u64, end: AbortHandle, kind: Kind) {
        self.add(Seated { id, end }, kind);
    }

    /// Ends some connections without the token, from the one heard of longest ago, and lets so many fewer in from now on: descriptors are short.
    pub(super) fn spare(&self) {
        let ended: Vec<Seated> = self.with(|kinds| {
            let [silent, strangers, ..] = kinds;
            let more = if silent.places.len() > strangers.places.len() { silent } else { strangers };
            let ended = more.places.drain(..more.places.len().min(SPARED)).collect();
            more.most = more.most.min(more.places.len().max(SPARED));
            ended
        });
        ended.iter().for_each(|place| place.end.abort());
    }

    fn add(&self, place: Seated, kind: Kind) {
        let over = self.with(|kinds| {
            let Queue { places, most } = &mut kinds[kind as usize];
            places.push_back(place);
            if places.len() > *most { places.pop_front() } else { None }
        });
        if let Some(oldest) = over {
            oldest.end.abort();
        }
    }

    fn take(&self, id: u64) -> Option<Seated> {
        self.with(|kinds| {
            kinds.iter_mut().find_map(|Queue { places, .. }| {
                places.iter().position(|p| p.id == id).and_then(|at| places.remove(at))
            })
        })
    }

    fn with<T>(&self, work: impl FnOnce(&mut [Queue; Kind::ALL.len()]) -> T) -> T {
        work(&mut self.kinds.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

/// A connection's place in the room, given back when it ends, however it ends.
#[derive(Debug)]
pub(super) struct Seat {
    pub(super) room: Arc<Room>,
    pub(super) id: u64,
}

impl Seat {
    /// The connection was heard of, as one of `kind`.
    pub(super) fn heard(&self, kind: Kind) {
        // Who is being ended already has no place any more.
        if let Some(place) = self.room.take(self.id) {
            self.room.add(place, kind);
        }
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        let _ = self.room.take(self.id);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Tasks that sit in a room until they are ended.
    async fn sit(room: &Arc<Room>, ids: std::ops::Range<u64>) -> Vec<tokio::task::JoinHandle<()>> {
        let tasks = ids.map(|id| {
            let seat = Seat { room: Arc::clone(room), id };
            let task = tokio::spawn(async move {
                let _seat = seat;
                std::future::pending().await
            });
            room.enter(id, task.abort_handle(), Kind::Stranger);
            task
        });
        let tasks = tasks.collect();
        tokio::task::yield_now().await;
        tasks
    }

    /// Until whoever was ended has gone.
    async fn go(done: impl Fn() -> bool) {
        for _ in 0..1000 {
            if done() {
                break;
            }
            tokio::task::yield_now().await;
        }
    }

    #[test]
    fn the_oldest_of_a_kind_goes_and_gives_its_place_back() {
        let runtime = tokio::runtime::Builder::new_current_thread().build().expect("a runtime");
        runtime.block_on(async {
            let room = Arc::new(Room::default());
            let most = Kind::Stranger.most();
            let first = sit(&room, 0..most as u64).await;
            // Known from now on, in the other order: none of the strangers' matter any more.
            for id in [1, 0] {
                let task = first[id as usize].abort_handle();
                drop(room.take(id));
                room.add(Seated { id, end: task }, Kind::Known);
            }
            let more = sit(&room, 1000..1003).await;
            go(|| first[2].is_finished()).await;
            let ended: Vec<usize> = (0..most).filter(|k| first[*k].is_finished()).collect();
            assert_eq!(ended, [2], "one over, the oldest stranger");
            assert!(more.iter().all(|task| !task.is_finished()));
            room.spare();
            go(|| (3..3 + SPARED).all(|k| first[k].is_finished())).await;
            assert!((3..3 + SPARED).all(|k| first[k].is_finished()) && !first[0].is_finished());
            let count = |kind: Kind| room.with(|kinds| kinds[kind as usize].places.len());
            assert_eq!((count(Kind::Stranger), count(Kind::Known)), (most - SPARED, 2));
            let late = sit(&room, 2000..2001).await;
            assert_eq!(count(Kind::Stranger), most - SPARED, "as many fewer from now on");
            first.iter().chain(&more).chain(&late).for_each(tokio::task::JoinHandle::abort);
            go(|| count(Kind::Stranger) + count(Kind::Known) == 0).await;
            assert_eq!((count(Kind::Stranger), count(Kind::Known)), (0, 0), "nobody is forgotten there");
            room.spare();
        });
    }
}
